"""Recorded runs: the profiles that drive them, how they are recorded, read and cut into training pairs.

The files lie beside the code. A room of `training/` that needs rows of a run gets them here.
"""
