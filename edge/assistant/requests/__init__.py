"""A person's request in words: asked of the model, checked, confirmed, and its predicted effect.

The request at work, as values that the tick applies, stands in `edge.tick.steering`.
"""
