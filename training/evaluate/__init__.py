"""Measurements of trained models: scores, costs, ablations, coverage of intervals, the two case studies.

The commands of `greenhouse-train` that compare models begin here; `report.py` and `pictures.py` show figures
and train nothing.
"""
