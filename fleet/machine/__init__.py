"""The machine that a fleet runs on: its authority, files of the engines, systemd's units, papers of each rig.

It writes files, starts and ends programs. People and what a browser sees are `fleet.page`'s.
"""
