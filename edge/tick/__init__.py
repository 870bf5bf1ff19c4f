"""One tick of control, from readings to the board.

`loop.py` alone knows the order. Sensor health, estimate, reference, orders of a person, choice of the
controller, conditions and faults, light and water. Everything is handed its time; nothing here waits for a
network or a disk.
"""
