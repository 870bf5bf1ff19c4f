"""The history file: opening, the check for damage a slice at a time, setting a damaged file aside.

The check for damage: a whole `PRAGMA quick_check` reads all of a year's file in one go, minutes on a slow
card. A slice reads some hundred rows of each table and index in milliseconds.
"""

import math
import shutil
import sqlite3
from contextlib import closing, suppress
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path

from edge.core.names import SIGNALS
from edge.formats.atomic_file import make_folder, move
from edge.formats.owner import as_owner, open_database
from edge.storage.schema_version import APPLICATION_ID, SCHEMA_VERSION, USABLE_VERSION

SLICE_ROWS = 200  # of each tree: some milliseconds a tick, and the default year is read in two days
_ORDERS = (  # table and the column whose order is walked: each is a tree of pages of its own in the file
    *(("ticks", "seq"), ("ticks", "utc"), ("events", "seq"), ("events", "utc"), ("readings", "seq")),
    *(("decisions", "seq"), ("forecasts", "seq"), ("changes", "seq"), ("ten_minutes", "start_utc")),
    *(("skill", "hour_utc"), ("gaps", "rowid"), ("outbox", "id"), ("outbox", "seq")),
    ("facts", "id"),
)


class SliceCheck:
    """One pass over the history at `path`."""

    def __init__(self, path: Path, busy_s: float) -> None:
        self._path, self._busy_s = path, busy_s
        self._below = dict.fromkeys(_ORDERS, math.inf)  # of each order that has rows left

    def step(self) -> bool:
        """Read the next slice. Returns whether rows are left. Errors: sqlite3.Error, for damage too

        The connection is new each time: an old one's cache can hide for long what the disk has lost.
        """
        if self._below:
            # Never makes a file where one was deleted.
            with closing(open_database(self._path, "mode=ro", timeout=self._busy_s)) as connection:
                self._below = {
                    order: lowest
                    for order, below in self._below.items()
                    if (lowest := _read_slice(connection, *order, below)) is not None
                }
        return bool(self._below)


def _read_slice(connection: sqlite3.Connection, table: str, key: str, below: float) -> float | None:
    """Read the rows whose keys come next below `below`. Returns the lowest key, None where there is none."""
    newest = f"SELECT {key} AS key FROM {table} WHERE {key} < ? ORDER BY {key} DESC LIMIT {SLICE_ROWS}"
    lowest = connection.execute(f"SELECT min(key) FROM ({newest})", (below,)).fetchone()[0]
    if lowest is None:
        return None
    columns = [name for (name,) in connection.execute("SELECT name FROM pragma_table_info(?)", (table,))]
    # A length needs the whole value, also one that is continued on further pages.
    lengths = ", ".join(f"total(length({column}))" for column in columns)
    connection.execute(
        f"SELECT {lengths} FROM {table} WHERE {key} >= ? AND {key} < ?", (lowest, below)
    ).fetchone()
    return float(lowest)


WAL_MAX_BYTES = 4 << 20  # a write-ahead log that grew longer is cut back
# Of a new file. A tick touches fifteen pages and changes some hundred bytes in each; each page it touches
# goes to the card twice, by the log and by the file. Larger pages write more (docs/measured/rig.md).
PAGE_BYTES = 512
CHECKPOINT_BYTES = 3 << 20  # a longer log writes a page that changes often fewer times into the file
# A log that grows makes the file system record its new length at every commit: two fifths of all writes.
RESERVED_BYTES = CHECKPOINT_BYTES + (256 << 10)
FREE_SHARE = 10  # so many times that has to be free on the disk
CACHE_KB = 1024


class FileFault(Enum):
    """The reaction that an sqlite3 error calls for."""

    WAIT = "wait"  # locked, full, read-only, no such directory: try again later
    REPLACE = "replace"  # corrupt, no database, from newer software: set it aside
    RECORD = "record"  # the rows themselves can't be stored


class Unusable(sqlite3.DatabaseError):
    """There is something at the path that is no history this software may write to; the text says what."""


_REPLACE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_FORMAT)


def fault_of(error: Exception) -> FileFault:
    """Classify `error`. Any error that is not SQLite's report about its file is the record's fault."""
    if isinstance(error, Unusable):
        return FileFault.REPLACE
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None and code & 0xFF in _REPLACE:  # the low byte is the primary code
        return FileFault.REPLACE
    # A table that is not there: the file has lost its schema.
    if isinstance(error, sqlite3.OperationalError) and "no such" in str(error):
        return FileFault.REPLACE
    return FileFault.WAIT if isinstance(error, (sqlite3.OperationalError, OSError)) else FileFault.RECORD


def connect(path: Path, busy_s: float) -> sqlite3.Connection:
    """Open an existing or new history, for use by one thread at a time.

    An existing one has USABLE_VERSION at least: the indexes that may be missing are the daemon's writer's to
    add, see `Archive.finish_migration`.

    busy_s : how long a statement may wait for another process's lock [s]
    Errors : sqlite3.Error, see `fault_of`; OSError for a directory that can't be made

    synchronous is FULL: a kill -9 would be survived without it, but after a power cut NORMAL can forget
    transactions that had been committed. Their ticks may have been published already, and the next start
    would give their numbers to other ticks. One sync per tick, in a thread that nobody waits for, is cheap.
    """
    make_folder(path.parent)
    if path.is_dir():
        raise Unusable("it is a directory")
    if path.exists() and path.stat().st_size == 0:
        raise Unusable("it is empty")  # as a power cut can leave a file: what it held is lost, so say so
    connection = open_database(path, timeout=busy_s, isolation_level=None, check_same_thread=False)
    try:
        _check_owner(connection)
        connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")  # this and the next count for a new file only
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA journal_size_limit = {WAL_MAX_BYTES}")
        page_bytes = connection.execute("PRAGMA page_size").fetchone()[0]  # an older file has pages of 4096
        connection.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT_BYTES // page_bytes}")
        connection.execute(f"PRAGMA cache_size = -{CACHE_KB}")
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version > SCHEMA_VERSION:
            # After a downgrade: newer software's file is not spoilt.
            raise Unusable(f"its version {version} is newer than {SCHEMA_VERSION}, the newest known here")
        if version < USABLE_VERSION:
            from edge.storage.schema import migrate

            migrate(connection, USABLE_VERSION if version else SCHEMA_VERSION)
        # A signal that was added to the software later has its rows already, but no column to be read by.
        columns = {row[1] for row in connection.execute("PRAGMA table_info(v_ticks)")}
        if not {signal.key for signal in SIGNALS.values()} <= columns:
            from edge.storage.schema import renew_tick_view

            renew_tick_view(connection)
        _reserve_log(path)
    except UnicodeDecodeError as error:  # what SQLite says of damaged tables repeats their bytes
        connection.close()
        raise Unusable(f"its description of the tables is damaged: {error.reason}") from None
    except BaseException:
        connection.close()
        raise
    return connection


def _reserve_log(path: Path) -> None:
    """Lengthen the write-ahead log by zeros; SQLite takes no frame from them, as their checksums are wrong.

    Appending is safe beside another process that writes: no byte that is there is touched. Where the disk is
    nearly full the log grows as it can, and leaves the rest to the file.
    """
    if shutil.disk_usage(path).free > FREE_SHARE * RESERVED_BYTES:
        with suppress(OSError), as_owner(path), path.with_name(f"{path.name}-wal").open("ab") as log:
            log.write(bytes(max(RESERVED_BYTES - log.tell(), 0)))


def _check_owner(connection: sqlite3.Connection) -> None:
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if tables and connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise Unusable("it is another program's database")


def identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of the file at `path`, None without one: tells when it was deleted or exchanged."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def set_aside(path: Path, utc: float) -> Path | None:
    """Move the database and its companions out of the way, never delete them.

    Returns : where the database is now, None when there was none. Errors: OSError
    """
    stamp = datetime.fromtimestamp(utc, UTC).strftime("%Y%m%dT%H%M%SZ")
    target = path.with_name(f"{path.name}.aside-{stamp}")
    number = 1
    while target.exists():
        number += 1
        target = path.with_name(f"{path.name}.aside-{stamp}-{number}")
    # The log first: a new database beside the old one's log would be taken for that log's own.
    for suffix in ("-wal", "-shm", ""):
        with suppress(FileNotFoundError):
            move(Path(f"{path}{suffix}"), Path(f"{target}{suffix}"))
    return target if target.exists() else None
