"""Where a twin and its measurements disagree, what is missing, and whether adding it closes the gap.

Recordings and a twin file go in, `diagnosis.json` and a report come out: locate, search, judge by rows that
no fit saw, plan the next experiment, report. The physics itself stands in `edge.twin`.
"""
