"""Thirty heated boxes that share no code, constant or structure with the project's own models.

facts is the description of a box; lots deals the qualities of fifteen boxes, draw draws a box or its siblings
and says how far and how fast the heater can warm it. rates turns facts into arrays, gives their slopes and
solves the linear part; physics steps states. box has the room and the sun as functions of time, and puts a
box behind the pins of a virtual board. clairvoyant has a limit for plans, and a PID tuned on the twin.
"""
