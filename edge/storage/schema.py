"""The history's tables and read views, grown step by step.

Imports sqlite_utils (10 MB resident), so it is itself imported only for a file that is new or behind.
"""

import sqlite3
import uuid
from collections.abc import Callable

from sqlite_utils import Database

from edge.core.horizons import HORIZONS_MIN
from edge.core.names import SIGNALS
from edge.storage.schema_version import APPLICATION_ID

INDEXES = {  # name -> table and column
    "ticks_by_utc": ("ticks", "utc"),
    "events_by_utc": ("events", "utc"),
    "outbox_by_seq": ("outbox", "seq"),
}
COMMAND_COLUMNS = {"heater_duty": float, "fan_on": int, "led": float, "valve_pulse_s": float}


def create_tables(db: Database) -> None:
    """Version 1. `utc` in seconds since 1970, units in the names; NULL where there was no number."""
    db.table("history").create({"id": str})
    db.table("history").insert({"id": str(uuid.uuid4())})
    db.table("sessions").create(
        {
            "session": int,
            "first_seq": int,  # number given to its first tick
            "started_utc": float,
            "ended_utc": float,  # NULL while it runs, or when it was killed
            "software_version": str,
            "config_sha256": str,
            "models": str,  # JSON: name -> version
        },
        pk="session",
    )
    db.table("ticks").create(
        {
            "seq": int,
            "session": int,
            "utc": float,
            "step_s": float,
            "mode": str,
            "controller": str,
            "reference_c": float,
            "estimate_temp_air_c": float,
            "estimate_sd_k": float,
            "estimate_offset_k_per_step": float,
            "innovation_k": float,
            "estimate_temp_ambient_c": float,
            **{f"wanted_{key}": kind for key, kind in COMMAND_COLUMNS.items()},
            **{f"sent_{key}": kind for key, kind in COMMAND_COLUMNS.items()},
            "echo_heater_duty": float,  # echo_*: NULL when the board did not confirm in time
            "echo_fan_on": int,
            "echo_led": float,
            "echo_valve_open": int,
            "echo_tripped": int,
            "echo_trip_cause": str,
            "link_up": int,
            "ticks_skipped": int,
            "late_s": float,
            "decide_ms": float,
        },
        pk="seq",
    )
    # sqlite_utils can't say WITHOUT ROWID, which spares these tables a second copy of their key.
    db.conn.execute(
        "CREATE TABLE readings (seq INTEGER, signal TEXT, value REAL, quality TEXT,"
        " PRIMARY KEY (seq, signal)) WITHOUT ROWID"
    )
    db.conn.execute(
        "CREATE TABLE changes (seq INTEGER, number INTEGER, rule TEXT, actuator TEXT, wanted REAL, sent REAL,"
        " reason TEXT, PRIMARY KEY (seq, number)) WITHOUT ROWID"
    )
    db.conn.execute(
        "CREATE TABLE events (seq INTEGER, number INTEGER, utc REAL, key TEXT, severity TEXT, text TEXT,"
        " PRIMARY KEY (seq, number)) WITHOUT ROWID"
    )
    db.conn.execute(
        "CREATE TABLE ten_minutes (start_utc INTEGER, quantity TEXT, rows INTEGER, mean REAL, low REAL,"
        " high REAL, PRIMARY KEY (start_utc, quantity)) WITHOUT ROWID"
    )
    db.table("decisions").create({"seq": int, "forecast_c": str, "why": str}, pk="seq")  # both JSON
    db.table("runs").create(
        {"name": str, "role": str, "first_seq": int, "last_seq": int, "facts": str}, pk="name"
    )
    db.table("gaps").create({"first_seq": int, "last_seq": int, "utc": float, "reason": str})
    # AUTOINCREMENT: the id of a message that was taken away is never given to another one.
    db.conn.execute(
        "CREATE TABLE outbox (id INTEGER PRIMARY KEY AUTOINCREMENT, seq INTEGER, event INTEGER,"
        " is_resend INTEGER)"
    )


def create_tick_view(db: Database) -> None:
    """Create the view of ticks, with a column for each signal."""
    readings = "".join(
        f"(SELECT value FROM readings r WHERE r.seq = t.seq AND r.signal = '{signal.key}'"
        f" AND r.quality = 'good') AS {signal.key}, "
        for signal in SIGNALS.values()
    )
    # What the board did not confirm counts as off, as it does in the loop.
    driven = ", ".join(
        f"CASE WHEN t.echo_trip_cause IS NULL THEN 0 ELSE t.echo_{name} END AS {name}"
        for name in ("heater_duty", "fan_on", "led")
    )
    db.create_view(
        "v_ticks",
        "SELECT t.seq, t.utc, strftime('%Y-%m-%dT%H:%M:%SZ', t.utc, 'unixepoch') AS time, t.step_s, t.mode,"
        f" t.controller, {readings} t.estimate_temp_air_c, t.reference_c, t.wanted_heater_duty,"
        " t.wanted_fan_on, t.sent_heater_duty, t.sent_fan_on,"
        f" {driven}, t.link_up, t.ticks_skipped FROM ticks t",
    )


def create_views(db: Database) -> None:
    """Version 2: what may be read by those who may read only."""
    create_tick_view(db)
    db.create_view(
        "v_changes",
        "SELECT c.seq, t.utc, c.rule, c.actuator, c.wanted, c.sent, c.reason"
        " FROM changes c JOIN ticks t USING (seq)",
    )
    db.create_view(
        "v_decisions",
        "SELECT d.seq, t.utc, t.controller, d.forecast_c, d.why FROM decisions d JOIN ticks t USING (seq)",
    )
    db.create_view("v_events", "SELECT seq, utc, key, severity, text FROM events")
    db.create_view("v_ten_minutes", "SELECT start_utc, quantity, rows, mean, low, high FROM ten_minutes")
    db.create_view("v_gaps", "SELECT first_seq, last_seq, utc, reason FROM gaps")


def add_monotonic_times(db: Database) -> None:
    """Version 3: how long ago the last tick was, whatever the wall clock did meanwhile."""
    db.conn.execute("ALTER TABLE sessions ADD COLUMN boot_id TEXT")  # "": its time_s mean nothing to others
    db.conn.execute("ALTER TABLE sessions ADD COLUMN started_time_s REAL")
    db.conn.execute("ALTER TABLE ticks ADD COLUMN time_s REAL")


def add_forecasts(db: Database) -> None:
    """Version 4: what each predictor expected at a tick, and how well it does, a row an hour.

    `temp_c` and `half_width_k` are JSON arrays over HORIZONS_MIN, see `forecast_rows`.
    """
    db.conn.execute(
        "CREATE TABLE forecasts (seq INTEGER, predictor TEXT, temp_c TEXT, half_width_k TEXT,"
        " outside INTEGER, reason TEXT, PRIMARY KEY (seq, predictor)) WITHOUT ROWID"
    )
    db.conn.execute(
        "CREATE TABLE skill (hour_utc INTEGER, predictor TEXT, horizon_min INTEGER, version TEXT,"
        " scored INTEGER, mae_k REAL, against_persistence REAL, against_pbm REAL, half_width_k REAL,"
        " covered REAL, PRIMARY KEY (hour_utc, predictor, horizon_min)) WITHOUT ROWID"
    )
    # Arrays keep one row a tick and predictor; the view makes a row for each horizon of them.
    horizon = " ".join(f"WHEN {place} THEN {minutes}" for place, minutes in enumerate(HORIZONS_MIN))
    width = "json_extract(f.half_width_k, '$[' || h.key || ']')"
    db.create_view(
        "v_forecasts",
        f"SELECT f.seq, t.utc, f.predictor, CASE h.key {horizon} END AS horizon_min, h.value AS temp_c,"
        f" h.value - {width} AS low_c, h.value + {width} AS high_c, f.outside"
        " FROM forecasts f JOIN ticks t USING (seq), json_each(f.temp_c) h WHERE h.value IS NOT NULL",
    )
    db.create_view(
        "v_skill",
        "SELECT hour_utc, predictor, horizon_min, version, scored, mae_k, against_persistence, against_pbm,"
        " half_width_k, covered FROM skill",
    )


def add_indexes(db: Database) -> None:
    """Version 5: rows by their time, and messages by their tick, in a year of history."""
    for index, (table, column) in INDEXES.items():
        db.conn.execute(f"CREATE INDEX {index} ON {table} ({column})")


def add_facts(db: Database) -> None:
    """Version 6: what was decided, noted and learnt, see `facts`. An erased id is never given again."""
    db.conn.execute(
        "CREATE TABLE IF NOT EXISTS facts (id INTEGER PRIMARY KEY AUTOINCREMENT, utc REAL, kind TEXT,"
        " text TEXT, author TEXT, about TEXT, edited_utc REAL)"
    )


MIGRATIONS: tuple[Callable[[Database], None], ...] = (
    create_tables,
    create_views,
    add_monotonic_times,
    add_forecasts,
    add_indexes,
    add_facts,
)


def migrate(connection: sqlite3.Connection, target: int) -> None:
    """Bring the open file to version `target`, all in one transaction. Errors: sqlite3.Error."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        # Read inside the transaction: another process may have come first.
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        for step in MIGRATIONS[version:target]:
            step(Database(connection))
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {max(version, target)}")
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def renew_tick_view(connection: sqlite3.Connection) -> None:
    """Replace the view of ticks by one that has every signal of this software. Errors: sqlite3.Error"""
    connection.execute("BEGIN IMMEDIATE")
    try:
        connection.execute("DROP VIEW v_ticks")
        create_tick_view(Database(connection))
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
