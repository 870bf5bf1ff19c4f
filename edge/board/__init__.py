"""The serial line to the microcontroller, the only room that imports `firmware_protocol`.

The board itself, the port, simulated time in lock-step with a virtual board, and a recorded run in its place.
Decisions do not belong here: the board is told what to drive and for how long.
"""
