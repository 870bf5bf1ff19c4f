"""Where a twin and its measurements disagree, what is missing, and whether adding it closes the gap."""
