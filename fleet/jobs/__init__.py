"""The jobs of a night: what boxes have in common, which are unlike their kind, and what a changed box lacks.

They read what ingest has stored and write their findings beside it; nothing here talks to a rig.
"""
