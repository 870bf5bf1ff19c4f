"""Values, names and the two seams that every room shares.

Signals and units, messages of a tick, errors, time, horizons, hard limits, and the protocols `Controller`
and `Predictor`. Nothing here opens a file, a port or a socket, but for jobs on other processes and machines
(`sweep`), and nothing imports another room.
"""
