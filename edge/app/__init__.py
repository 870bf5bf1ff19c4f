"""The wiring: the only room that puts all others together.

The daemon, replay, experiment, nightly diagnosis, the display, and the choice of models and controllers by
the settings. A rule of physics, safety or control does not belong here.
"""
