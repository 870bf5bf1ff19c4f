"""Tables over SQLite or PostgreSQL: rigs, events, bundles, twins, jobs and people. Numbers are not here.

One file a subject; each table is declared once, by SQLAlchemy, and reads the same from both engines.
"""
