"""Diagnosis: find where a twin and its measurements disagree, name the missing effect, show the smaller gap.

Recordings and a twin file go in, `diagnosis.json` and a report come out: locate, search, judge by rows that
no fit saw, plan the next experiment, report. The physics itself stands in `edge.twin`.
"""
