"""Models and their training: one script per model, the training loop, the free run, and kept trainings.

`registry.py` names every model. `training.export` makes files for a rig, `training.evaluate` compares.
"""
