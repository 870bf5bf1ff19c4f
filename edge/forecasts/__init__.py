"""Forecasts of each predictor, their intervals, and their scores. Values in, values out.

Intervals, scores against what came true, and the state that survives a restart.
"""
