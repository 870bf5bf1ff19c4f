"""Priors of values and effects: the twins of a fleet become the start of a new box's twin.

Only twins come in: no reading of a rig is needed, and none is asked for.
"""
