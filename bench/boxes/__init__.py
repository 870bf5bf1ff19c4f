"""Thirty heated boxes that share no code, constant or structure with the project's own models.

facts is the description of a box; lots deals the qualities of fifteen boxes, draw draws a box from its seed.
nodes turns facts into arrays, rates gives their slopes, modes solves the linear part, physics steps states.
disturbances is the room and the sun as functions of time. box puts a box behind the pins of a virtual board.
reach says how far and how fast the heater can warm a box.
"""
