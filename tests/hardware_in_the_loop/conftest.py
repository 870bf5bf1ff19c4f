"""The whole daemon against a virtual board."""
