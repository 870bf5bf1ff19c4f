"""The writer's side of the history: one open file, one session in it, one transaction per batch."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

from edge.config.settings import HistorySettings
from edge.core.hard_limits import STEP_MIN_S
from edge.core.messages import TickRecord
from edge.formats.owner import open_database
from edge.storage.facts import insert_learnt
from edge.storage.file import SliceCheck, Unusable, connect, identity
from edge.storage.retention import thin
from edge.storage.schema_version import SCHEMA_VERSION
from edge.storage.tick_rows import insert_ticks

BUSY_S = 1.0  # how long one statement waits for another process's lock
_LAST_SIGN = f"""
SELECT boot_id, coalesce(time_s, started_time_s), coalesce(step_s, {STEP_MIN_S})
FROM sessions LEFT JOIN (SELECT * FROM ticks WHERE seq > 0 ORDER BY seq DESC LIMIT 1) USING (session)
ORDER BY session DESC LIMIT 1
"""


@dataclass(frozen=True, slots=True)
class Session:
    """Which software and models a stretch of ticks was recorded with."""

    software_version: str = ""
    config_sha256: str = ""
    models: Mapping[str, str] = field(default_factory=dict)  # name -> version
    boot_id: str = ""  # sessions of one boot share their monotonic time; "": with no other session


@dataclass(frozen=True, slots=True)
class LastSign:
    """The last tick of the newest session in the file, or its start."""

    boot_id: str
    time_s: float
    step_s: float


@dataclass(frozen=True, slots=True)
class NumberGap:
    """Numbers that were given to ticks, or may have been, and are not in the file."""

    first_seq: int
    last_seq: int
    reason: str


class Archive:
    """Used by one thread at a time. Every method may raise sqlite3.Error or OSError, see `file.fault_of`."""

    def __init__(self, path: Path, session: Session, started_s: float) -> None:
        self.path = path
        self.first_seq = 0  # of the ticks in the file, 0 when there is none
        self.last_seq = 0  # largest number ever given out as far as the file knows
        self.session_first_seq = 0  # first number of the session before this one
        self.ended_cleanly = True  # the session before this one
        self.last_sign: LastSign | None = None  # of the session before this one
        self._session, self._started_s = session, started_s
        self._session_id: int | None = None
        self._connection: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        self._check = SliceCheck(path, BUSY_S)

    def open(self) -> None:
        """Open or make the file and learn where its numbers stand."""
        self.close()
        connection = connect(self.path, BUSY_S)
        self._connection, self._identity = connection, identity(self.path)
        self.first_seq, ticks_last, gaps_last, session_first = connection.execute(
            "SELECT coalesce((SELECT min(seq) FROM ticks WHERE seq > 0), 0),"
            " coalesce((SELECT max(seq) FROM ticks), 0), coalesce((SELECT max(last_seq) FROM gaps), 0),"
            " coalesce((SELECT max(first_seq) FROM sessions), 1)"
        ).fetchone()
        # Negative numbers are imported runs: they don't count.
        self.last_seq = max(ticks_last, gaps_last, session_first - 1)
        newest = connection.execute(
            "SELECT first_seq, ended_utc IS NOT NULL FROM sessions ORDER BY session DESC LIMIT 1"
        ).fetchone()
        self.session_first_seq, self.ended_cleanly = newest or (0, True)
        sign = connection.execute(_LAST_SIGN).fetchone()
        self.last_sign = None if sign is None or None in sign else LastSign(*sign)

    def needs_migration(self) -> bool:
        """Return whether indexes or the table of facts are missing."""
        version = self.open_connection().execute("PRAGMA user_version").fetchone()[0]
        return bool(version < SCHEMA_VERSION)

    def finish_migration(self) -> None:
        """Add what is missing, in one transaction; a year of ticks takes seconds, on a slow card minutes."""
        from edge.storage.schema import migrate

        migrate(self.open_connection(), SCHEMA_VERSION)

    def interrupt(self) -> None:
        """End the statement that runs in the archive's own thread; it raises there. From any thread."""
        with suppress(AttributeError, sqlite3.ProgrammingError):  # closed, or being closed
            self._connection.interrupt()  # type: ignore[union-attr]

    def check_slice(self) -> bool:
        """Look for damage in the next slice of the file. Returns whether slices are left."""
        return self._check.step()

    def append(
        self, records: Sequence[TickRecord], gaps: Sequence[NumberGap], next_seq: int, utc: float
    ) -> None:
        """Write a batch, all or nothing; with the first one the session begins, at tick `next_seq`."""
        connection = self.open_connection()
        self._look()
        if self._session_id is None and not self.last_seq < next_seq:
            raise Unusable(f"it holds another history's ticks, up to {self.last_seq}")
        connection.execute("BEGIN IMMEDIATE")
        try:
            session_id = self._session_id or self._begin_session(connection, next_seq, utc)
            insert_ticks(connection, records, session_id)
            if not self.needs_migration():
                insert_learnt(connection, records)
            connection.executemany(
                "INSERT INTO gaps VALUES (?, ?, ?, ?)",
                [(gap.first_seq, gap.last_seq, utc, gap.reason) for gap in gaps],
            )
            connection.execute("COMMIT")
        finally:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
        self._session_id = session_id
        if records:
            self.first_seq = self.first_seq or records[0].seq
            self.last_seq = records[-1].seq

    def end_session(self, utc: float) -> None:
        """Note that the session ended as it should."""
        self.open_connection().execute(
            "UPDATE sessions SET ended_utc = ? WHERE session = ?", (utc, self._session_id)
        )

    def thin(self, settings: HistorySettings) -> tuple[bool, int]:
        """One chunk of retention, see `retention.thin`."""
        return thin(self.open_connection(), settings)

    def close(self) -> None:
        """Close the file; its name may be another file's afterwards."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def forget(self) -> None:
        """Close for good: what is opened next is another file with a session of its own."""
        self.close()
        self._session_id = None
        self._check = SliceCheck(self.path, BUSY_S)
        self.first_seq = self.last_seq = 0

    def _look(self) -> None:
        """See the file as a newcomer does: this connection's cache can hide for long that it is broken."""
        if identity(self.path) != self._identity:
            raise Unusable("it was deleted or exchanged")
        with closing(open_database(self.path, timeout=BUSY_S)) as newcomer:
            newcomer.execute("SELECT max(seq) FROM ticks").fetchone()

    def open_connection(self) -> sqlite3.Connection:
        """Return the connection, opened if it was not."""
        if self._connection is None:
            self.open()
        assert self._connection is not None
        return self._connection

    def _begin_session(self, connection: sqlite3.Connection, next_seq: int, utc: float) -> int:
        cursor = connection.execute(
            "INSERT INTO sessions (first_seq, started_utc, software_version, config_sha256, models, boot_id,"
            " started_time_s) VALUES (?, ?, ?, ?, ?, ?, ?)",
            (
                next_seq,
                utc,
                self._session.software_version,
                self._session.config_sha256,
                json.dumps(dict(self._session.models), sort_keys=True),
                self._session.boot_id,
                self._started_s,
            ),
        )
        assert cursor.lastrowid is not None
        return cursor.lastrowid
