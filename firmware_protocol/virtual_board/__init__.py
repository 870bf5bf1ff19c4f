"""A board made of software behind a pseudo-terminal: firmware core, simulated greenhouse, and faults.

README.md says how the board is run, and CHAMBER.md gives the physics. No code is shared with `edge/`: a twin
that is tested here must not meet its own equations.
"""
