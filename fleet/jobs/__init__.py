"""The jobs of a night: what a changed box lacks.

They read what ingest has stored and write their findings beside it; nothing here talks to a rig.
"""
