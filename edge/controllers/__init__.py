"""Controllers: each is `decide(context) -> Decision`, pure, and replaceable while the rig runs.

Rules, PID, MPC by mixed-integer search and by rollouts, MPC over the twin, the paper's own, a trained policy,
another process. Which name means which of them is chosen by `edge.app.controllers`.
"""
