"""The fitted twin for lessons and for controllers of other people: a box in Python, without rig or daemon.

A lab with the calls of TCLab (`tclab`) and a Gymnasium environment (`environment`, needs the extra `gym`).
Both share a box that is stepped command by command, drawn episodes, and the cost. Daemon, board and safety do
not belong here: `training/lab.py` runs a whole rig in simulated time.
"""

from edge.lab.lab_time import clock, labtime
from edge.lab.tclab import TwinLab, lab, setup

__all__ = ["TwinLab", "clock", "lab", "labtime", "setup"]
