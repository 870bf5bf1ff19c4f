"""Thirty heated boxes that share no code, constant or structure with the project's own models.

facts is the description of a box, draw draws it from a seed. nodes turns it into arrays, physics steps them.
disturbances is the room and the sun as functions of time. box puts a box behind the pins of a virtual board.
reach says how far and how fast the heater can warm a box.
"""
