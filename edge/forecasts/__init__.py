"""What each predictor expects, how far it can be trusted, and how well it did. Values in, values out.

Intervals, scores against what came true, and the state that survives a restart.
"""
