"""Evidence of a rig: its record sealed day by day, checked by a stranger, reported against fixed thresholds.

The protocol's thresholds, rows of the history by day, the chain of signed days, its proof and its report.
Running a rig, and judging one by anything that is not in the sealed record, do not belong here.
"""
