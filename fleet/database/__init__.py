"""Tables over SQLite or PostgreSQL: rigs, events, bundles, twins, jobs and people. Numbers are not here.

Each table is declared once in tables.py, by SQLAlchemy, and reads the same from both engines.
"""
