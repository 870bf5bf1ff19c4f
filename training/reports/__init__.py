"""Tables, pictures and pages of comparisons, out of measured figures.

The figures come from `training.evaluate` and `training.control`. Nothing here trains or drives a rig.
"""
