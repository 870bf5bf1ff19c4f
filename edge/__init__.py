"""The daemon that runs on the rig. It never imports training/ or torch."""

__version__ = "0.1.0"
