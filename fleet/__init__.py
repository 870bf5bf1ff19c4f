"""Many rigs: one view, bundles that spread in waves.

It imports edge and nothing of edge imports it: a rig alone needs none of it. Messages, numbers, tables, jobs
and the way in are engines that exist: mosquitto, VictoriaMetrics, SQLAlchemy over SQLite or PostgreSQL, Dask,
caddy.
"""
