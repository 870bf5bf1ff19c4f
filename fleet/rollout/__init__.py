"""A signed bundle that spreads over a fleet in waves, is judged by control cost, and rolled back if it harms.

Plans and judgements are functions of values; the runner alone talks to rigs, and all that it knows is in the
database, so a killed runner goes on where it was. What a rig does with an order is `edge.bundle`'s.
"""
