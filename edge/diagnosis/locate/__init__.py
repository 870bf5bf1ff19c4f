"""Where, when and how much a twin disagrees with measured runs, and what the disagreement depends on."""
