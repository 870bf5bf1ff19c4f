"""A diagnosis to look at: one HTML file with pictures, a summary for the terminal."""
