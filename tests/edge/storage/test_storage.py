"""The history's writer: what it keeps, and that nothing stops it."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from history_records import HandClock, History, eventful_tick, tick
from sqlite_utils import Database

from edge.formats.tick_json import tick_json
from edge.storage import Outbox, Session, Storage, schema
from edge.storage import storage as storage_module
from edge.storage.file import FREE_SHARE, RESERVED_BYTES, Unusable, connect
from edge.storage.numbers import NumbersFile, Reservation
from edge.storage.runs import export_run
from edge.storage.schema_version import SCHEMA_VERSION, USABLE_VERSION, VIEWS
from edge.storage.tick_rows import read_ticks

PATIENCE_S = 20.0
RESERVED = 50 + storage_module.BATCH_TICKS  # numbers that a session may give out before the next reservation


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage_module, "RETRY_FIRST_S", 0.02)
    monkeypatch.setattr(storage_module, "RETRY_MAX_S", 0.02)
    monkeypatch.setattr("edge.storage.archive.BUSY_S", 0.02)


@contextmanager
def opened(path: Path, **settings: object) -> Iterator[tuple[Storage, int]]:
    storage = Storage(History.at(path, **settings), HandClock())
    first = storage.open()
    try:
        yield storage, first
    finally:
        storage.close(PATIENCE_S)


def rows(path: Path, query: str) -> list[tuple[object, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query).fetchall()


def seqs(path: Path) -> list[int]:
    return [seq for (seq,) in rows(path, "SELECT seq FROM ticks ORDER BY seq")]


def write(storage: Storage, *numbers: int) -> None:
    for seq in numbers:
        storage.write(tick(seq))


def asides(path: Path) -> list[Path]:
    return sorted(p for p in path.parent.glob("*.aside-*") if not p.name.endswith(("-wal", "-shm")))


# what is kept


def test_a_new_history_makes_its_directory_and_begins_with_tick_one(tmp_path: Path) -> None:
    with opened(tmp_path / "a" / "b" / "history.db") as (storage, first):
        assert first == 1
        assert not storage.wait_written(1, 0.0)


@pytest.mark.parametrize("make", [tick, eventful_tick])
def test_a_stored_tick_reads_back_as_the_same_json(path: Path, make) -> None:
    record = make(1)
    with opened(path) as (storage, _):
        storage.write(record)
    with closing(connect(path, 1.0)) as connection:
        back = read_ticks(connection, [1])[1]
    expected = tick_json(record)
    if make is eventful_tick:  # JSON has no infinity and no tuple
        expected["why"] = {"cost": None, "parts": [1, {"a": None}]}
    assert tick_json(back) == expected
    json.dumps(tick_json(back), allow_nan=False)


def test_the_log_has_its_whole_length_before_the_first_tick_and_loses_nothing_by_it(
    path: Path, tmp_path: Path
) -> None:
    with opened(path) as (storage, _):
        write(storage, 1, 2)
        assert storage.wait_written(2, 10.0)
        log = path.with_name(f"{path.name}-wal")
        assert log.stat().st_size == RESERVED_BYTES
        # What a power cut leaves is read by whoever comes next, with a log that is shorter too.
        for cut_bytes in (RESERVED_BYTES, RESERVED_BYTES - 1000, RESERVED_BYTES // 2):
            copy = tmp_path / f"{cut_bytes}.db"
            shutil.copyfile(path, copy)
            copy.with_name(f"{copy.name}-wal").write_bytes(log.read_bytes()[:cut_bytes])
            with closing(connect(copy, 1.0)):
                assert seqs(copy) == [1, 2]
                assert copy.with_name(f"{copy.name}-wal").stat().st_size == RESERVED_BYTES


def test_on_a_small_disk_the_log_takes_no_room_that_the_file_needs(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = FREE_SHARE * RESERVED_BYTES
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    with opened(path) as (storage, _):
        write(storage, 1)
        assert storage.wait_written(1, 10.0)
        assert path.with_name(f"{path.name}-wal").stat().st_size < RESERVED_BYTES // 10


def test_a_reading_without_a_number_is_null_and_keeps_its_quality(path: Path) -> None:
    with opened(path) as (storage, _):
        storage.write(eventful_tick(1))
    assert rows(path, "SELECT signal, value, quality FROM readings") == [("temp_air_c", None, "fault")]
    assert rows(path, "SELECT temp_air_c FROM v_ticks") == [(None,)]


def test_an_unconfirmed_command_counts_as_off_in_the_view(path: Path) -> None:
    with opened(path) as (storage, _):
        storage.write(tick(7))
        storage.write(tick(9, echo=None))
    assert rows(path, "SELECT seq, heater_duty, fan_on FROM v_ticks") == [
        (7, 0.35000000000000003, 1),
        (9, 0, 0),
    ]


def test_every_view_reads(path: Path) -> None:
    with opened(path) as (storage, _):
        storage.write(eventful_tick(1))
    assert [len(rows(path, f"SELECT * FROM {view}")) for view in VIEWS] == [1, 1, 1, 2, 0, 0, 2, 0]


def test_a_session_says_with_what_it_was_recorded(path: Path) -> None:
    storage = Storage(History.at(path), HandClock(), Session("1.2.3", "abc", {"arx": "v7"}))
    storage.open()
    assert storage.close(PATIENCE_S)
    assert rows(
        path, "SELECT first_seq, software_version, config_sha256, models, ended_utc NOTNULL FROM sessions"
    ) == [(1, "1.2.3", "abc", '{"arx": "v7"}', 1)]


def killed(path: Path, boot_id: str, ticks: int) -> None:
    """Leave a history as a kill -9 does after so many ticks, at 60 s, 120 s, ... of the monotonic clock."""
    storage = Storage(History.at(path), HandClock(time_s=0.0), Session(boot_id=boot_id))
    write(storage, *range(storage.open(), ticks + 1))
    assert storage.close(PATIENCE_S)
    as_a_kill_leaves_it(path)


def as_a_kill_leaves_it(path: Path) -> None:
    """Take back what the end of the session noted, in the file and alongside it."""
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE sessions SET ended_utc = NULL")
        (first,) = connection.execute("SELECT max(first_seq) FROM sessions").fetchone()
    NumbersFile(path).write(Reservation(first, first + RESERVED, is_final=False))


@pytest.mark.parametrize(
    ("ticks", "now_s", "given"),  # given: ticks there can have been after the last one written, one spare
    [(3, 180.0, 2), (3, 239.9, 2), (3, 240.0, 3), (3, 180.0 + 3600.0, 62), (0, 5.0, 7)],
)
def test_after_a_kill_the_time_since_bounds_the_numbers_left_out(
    path: Path, ticks: int, now_s: float, given: int
) -> None:
    killed(path, "this boot", ticks)
    storage = Storage(History.at(path), HandClock(time_s=now_s), Session(boot_id="this boot"))
    assert storage.open() == ticks + given + 1
    assert storage.close(PATIENCE_S)
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(ticks + 1, ticks + given)]


@pytest.mark.parametrize(("before", "now"), [("a", "b"), ("", ""), ("a", ""), ("", "a")])
def test_after_another_boot_the_time_bounds_nothing(path: Path, before: str, now: str) -> None:
    killed(path, before, ticks=3)
    storage = Storage(History.at(path), HandClock(time_s=200.0), Session(boot_id=now))
    assert storage.open() == 1 + RESERVED
    assert storage.close(PATIENCE_S)


def test_a_session_before_version_three_bounds_nothing(path: Path) -> None:
    killed(path, "this boot", ticks=3)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE sessions SET boot_id = NULL, started_time_s = NULL")
    Path(f"{path}-numbers").unlink()  # as young as the indexes
    storage = Storage(History.at(path), HandClock(time_s=200.0), Session(boot_id="this boot"))
    assert storage.open() == 4 + RESERVED
    assert storage.close(PATIENCE_S)


def test_after_an_unclean_end_numbers_that_may_have_been_given_out_are_left_out(path: Path) -> None:
    with opened(path, queue_ticks=10) as (storage, first):
        write(storage, 1, 2, 3)
    as_a_kill_leaves_it(path)
    with opened(path, queue_ticks=10) as (storage, first):
        assert first == 4 + 10 + storage_module.BATCH_TICKS
        (event,) = storage.events_pending()
        assert event.key == "history.unclean_stop"
        assert "tick 3 is the last one in the history" in event.text
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(4, first - 1)]


def test_a_session_killed_before_its_first_tick_gives_no_number_twice(path: Path) -> None:
    with opened(path):
        pass
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE sessions SET first_seq = 500")
    as_a_kill_leaves_it(path)
    with opened(path) as (_, first):
        assert first > 500


def test_closing_before_opening_is_nothing(path: Path) -> None:
    assert not Storage(History.at(path), HandClock()).close()


# what can't be stored


def test_rows_that_cannot_be_stored_are_left_out_and_told(path: Path) -> None:
    with opened(path) as (storage, _):
        storage.write(tick(1))
        storage.write(tick(2, mode=object()))
        storage.write(tick(3))
        assert storage.wait_written(3, PATIENCE_S)
        assert storage.lost_ticks == 1
        (event,) = storage.events_pending()
    assert event.key == "history.ticks_lost"
    assert "ticks 2 to 2" in event.text
    assert seqs(path) == [1, 3]
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(2, 2)]


def test_a_number_given_twice_keeps_the_first_tick(path: Path) -> None:
    with opened(path) as (storage, _):
        storage.write(tick(1, mode="auto"))
        storage.write(tick(1, mode="manual"))
        storage.write(tick(2))
        assert storage.wait_written(2, PATIENCE_S)
    assert rows(path, "SELECT seq, mode FROM ticks") == [(1, "auto"), (2, "auto")]


# a file that is broken


def half(data: bytes) -> bytes:
    return data[: len(data) // 2]


def header_broken(data: bytes) -> bytes:
    return os.urandom(100) + data[100:]


def middle_broken(data: bytes) -> bytes:
    return data[:8192] + os.urandom(len(data) - 16384) + data[-8192:]


def names_broken(data: bytes) -> bytes:
    """Damage of a table's name and definition: SQLite's complaint repeats bytes that are no text."""
    data = data.replace(b"tablehistoryhistory", b"tablehisto\xcc\xffhistory")
    return data.replace(b"CREATE TABLE", b"CREATE TABXX")


@pytest.mark.parametrize(
    "damage", [half, header_broken, middle_broken, names_broken, lambda data: b"", lambda data: b"hello"]
)
def test_a_broken_file_is_set_aside_and_a_new_history_begun(path: Path, damage) -> None:
    with opened(path) as (storage, _):
        write(storage, *range(1, 41))
    damaged = damage(whole := path.read_bytes())
    assert damaged != whole
    path.write_bytes(damaged)
    with opened(path) as (storage, first):
        storage.write(tick(first))
        assert storage.wait_written(first, PATIENCE_S)
        assert "set aside as history.db.aside-" in storage.faults()["history.replaced"]
        assert "history.replaced" not in storage.faults()  # told once
    assert seqs(path) == [first]
    (aside,) = asides(path)
    # sqlite3 may have touched the header when it opened the file; what was in it is all there.
    assert aside.stat().st_size == len(damaged)


def test_a_complaint_with_bytes_that_are_no_text_is_of_a_broken_file(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1)
    path.write_bytes(names_broken(path.read_bytes()))
    with pytest.raises(Unusable, match="its description of the tables is damaged"):
        connect(path, 1.0)


def test_a_directory_in_place_is_set_aside(path: Path) -> None:
    path.mkdir()
    (path / "mine").write_text("kept")
    with opened(path) as (storage, first):
        write(storage, first)
    assert seqs(path) == [1]
    assert (asides(path)[0] / "mine").read_text() == "kept"


def test_a_file_of_newer_software_is_set_aside_unharmed(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    with opened(path) as (storage, first):
        assert first == 2
        assert "newer" in storage.faults()["history.replaced"]
    assert seqs(asides(path)[0]) == [1]
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(1, 1)]


def test_somebody_elses_database_is_set_aside(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE ticks (price REAL)")
        connection.execute("INSERT INTO ticks VALUES (2.5)")
    with opened(path) as (storage, first):
        write(storage, first)
    assert seqs(path) == [1]
    assert rows(asides(path)[0], "SELECT price FROM ticks") == [(2.5,)]


def test_a_file_that_breaks_while_it_is_used_is_replaced_and_its_ticks_are_counted(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, *range(1, 41))
        assert storage.wait_written(40, PATIENCE_S)
        for name in (path, Path(f"{path}-wal")):
            with name.open("r+b") as file:
                file.write(os.urandom(name.stat().st_size))
        write(storage, 41)
        assert storage.wait_written(41, PATIENCE_S)
        assert "ticks 1 to 40 are no longer in the history" in storage.faults()["history.replaced"]
    assert seqs(path) == [41]
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(1, 40)]
    assert rows(path, "PRAGMA integrity_check") == [("ok",)]


def test_a_deleted_file_is_noticed_and_its_ticks_are_counted(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1, 2, 3)
        assert storage.wait_written(3, PATIENCE_S)
        path.unlink()
        write(storage, 4)
        assert storage.wait_written(4, PATIENCE_S)
        told = storage.faults()["history.replaced"]
        assert "deleted" in told
        assert "ticks 1 to 3 are no longer in the history" in told
    assert seqs(path) == [4]
    assert rows(path, "SELECT first_seq, last_seq FROM gaps") == [(1, 3)]


def test_a_deleted_directory_is_made_again(tmp_path: Path) -> None:
    path = tmp_path / "state" / "history.db"
    with opened(path) as (storage, _):
        write(storage, 1)
        assert storage.wait_written(1, PATIENCE_S)
        shutil.rmtree(path.parent)
        write(storage, 2)
        assert storage.wait_written(2, PATIENCE_S)
    assert seqs(path) == [2]


def test_an_exchanged_file_with_later_ticks_is_not_mixed_with_ours(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.db"
    with opened(other) as (storage, _):
        write(storage, 100)
    with opened(path) as (storage, _):
        write(storage, 1)
        assert storage.wait_written(1, PATIENCE_S)
        other.replace(path)
        write(storage, 2)
        assert storage.wait_written(2, PATIENCE_S)
    assert seqs(path) == [2]


def test_two_replacements_in_one_second_do_not_share_a_name(path: Path) -> None:
    for _ in range(2):
        path.write_bytes(b"no database")
        with opened(path):
            pass
    assert len(asides(path)) == 2


# a disk or a neighbour that does not let it


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Another connection that holds the write lock."""
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.execute("ROLLBACK")


def until(condition) -> None:
    """Wait for another thread, without a sleep that has to be right."""
    gate = storage_module.threading.Event()
    for _ in range(2000):
        if condition():
            return
        gate.wait(0.01)
    raise AssertionError("never came true")


def test_a_locked_database_delays_the_ticks_and_loses_none(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1)
        assert storage.wait_written(1, PATIENCE_S)
        with locked(path):
            write(storage, 2, 3)
            until(lambda: "history.behind" in storage.faults())
            assert "locked" in storage.faults()["history.behind"]
            assert not storage.wait_written(2, 0.0)
        assert storage.wait_written(3, PATIENCE_S)
        until(lambda: not storage.faults())
        assert storage.events_pending() == []
    assert seqs(path) == [1, 2, 3]


def test_a_full_queue_drops_the_oldest_ticks_and_counts_them(path: Path) -> None:
    with opened(path, queue_ticks=10) as (storage, _):
        write(storage, 1)
        assert storage.wait_written(1, PATIENCE_S)
        with locked(path):
            write(storage, 2)
            until(lambda: "history.behind" in storage.faults())  # tick 2 is in the writer's hands
            write(storage, *range(3, 20))
        assert storage.wait_written(19, PATIENCE_S)
        until(lambda: storage.lost_ticks == 7)
        events = storage.events_pending()  # one, or more where the writer tried between two of the ticks
        assert {event.key for event in events} == {"history.ticks_lost"}
        assert all("are not in the history: the queue was full" in event.text for event in events)
    assert seqs(path) == [1, 2, *range(10, 20)]
    gaps = rows(path, "SELECT first_seq, last_seq FROM gaps ORDER BY 1")
    assert [seq for first, last in gaps for seq in range(first, last + 1)] == list(range(3, 10))


def test_a_history_that_stays_locked_does_not_hold_up_the_end(path: Path) -> None:
    storage = Storage(History.at(path), HandClock())
    storage.open()
    write(storage, 1)
    assert storage.wait_written(1, PATIENCE_S)
    with locked(path):
        write(storage, 2)
        assert not storage.close(timeout_s=0.2)
    storage.close(PATIENCE_S)  # its thread would have ended with the process
    with opened(path) as (storage, first):
        told = [event.key for event in storage.events_pending()]
    assert told == ([] if first == 3 else ["history.unclean_stop"])  # tick 2: as it got the lock, or not


FULL = """
import resource, sys
from pathlib import Path
sys.path[:0] = [sys.argv[2]]
from history_records import HandClock, History, tick
from edge.storage import Storage, storage as module

module.RETRY_FIRST_S = module.RETRY_MAX_S = 0.02
storage = Storage(History.at(Path(sys.argv[1]), queue_ticks=2000), HandClock())
storage.open()
storage.write(tick(1))
assert storage.wait_written(1, 20)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))
seq = 1
while not storage.faults() and seq < 20000:  # until the disk is full
    seq += 1
    storage.write(tick(seq))
    if seq % 100 == 0:
        storage.wait_written(seq, 1)
assert "history.behind" in storage.faults(), storage.faults()
assert not storage.wait_written(seq, 0.0)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
assert storage.wait_written(seq, 20)
assert storage.lost_ticks == 0
assert storage.close(20)
print(seq)
"""


@pytest.mark.slow
def test_a_full_disk_delays_the_ticks_and_loses_none(path: Path) -> None:
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path), str(root / "tests" / "support")],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert seqs(path) == list(range(1, int(done.stdout) + 1))
    assert rows(path, "PRAGMA integrity_check") == [("ok",)]


def test_a_path_that_cannot_be_made_is_told_and_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with opened(tmp_path / "file" / "history.db") as (storage, first):
        assert first > 0
        write(storage, first)
        assert "history.behind" in storage.faults()
        storage.close(0.1)


# older versions


def test_a_history_of_an_older_version_is_brought_up_with_its_ticks(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1, 2)
    with closing(sqlite3.connect(path)) as connection, connection:
        for view in VIEWS:
            connection.execute(f"DROP VIEW {view}")
        for table in ("forecasts", "skill", "facts"):
            connection.execute(f"DROP TABLE {table}")
        for index in schema.INDEXES:
            connection.execute(f"DROP INDEX {index}")
        for table, column in (("sessions", "boot_id"), ("sessions", "started_time_s"), ("ticks", "time_s")):
            connection.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
        connection.execute("PRAGMA user_version = 1")  # the application's id stays
    fresh = path.with_name("first-version.db")
    with closing(sqlite3.connect(fresh)) as connection:
        schema.create_tables(Database(connection))
        connection.commit()
    tables = "SELECT name, sql FROM sqlite_master WHERE name NOT LIKE 'sqlite_%' ORDER BY name"
    assert rows(path, tables) == rows(fresh, tables)
    with opened(path) as (storage, first):
        assert first == 3
        until(lambda: storage.faults() == {})  # but for indexes, which a thread builds
    assert [len(rows(path, f"SELECT * FROM {view}")) for view in VIEWS] == [2, 0, 2, 0, 0, 0, 0, 0]


def test_the_version_known_without_sqlite_utils_is_the_schemas() -> None:
    assert len(schema.MIGRATIONS) == SCHEMA_VERSION


def without_indexes(path: Path) -> None:
    """Turn a history into one of version 4."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for index in schema.INDEXES:
            connection.execute(f"DROP INDEX {index}")
        connection.execute(f"PRAGMA user_version = {USABLE_VERSION}")


def version(path: Path) -> int:
    return rows(path, "PRAGMA user_version")[0][0]


@pytest.fixture
def slow_indexes(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """A history of version 4, whose indexes take as long to build as the event is not set."""
    with opened(path) as (storage, first):
        write(storage, first)
    without_indexes(path)
    go_on = threading.Event()

    def build(db: Database) -> None:
        db.conn.create_function("go_on", 0, go_on.is_set)
        # Work of sqlite's own, which an interrupt ends.
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE NOT go_on())"
        db.conn.execute(f"{endless} SELECT count(*) FROM n").fetchone()
        schema.add_indexes(db)

    migrations = schema.MIGRATIONS
    indexes = migrations.index(schema.add_indexes)
    monkeypatch.setattr(schema, "MIGRATIONS", (*migrations[:indexes], build, *migrations[indexes + 1 :]))
    yield go_on
    go_on.set()


def test_the_first_tick_does_not_wait_for_indexes_that_are_built(
    path: Path, slow_indexes: threading.Event
) -> None:
    with opened(path) as (storage, first):
        assert first == 2
        until(lambda: "indexes are being built" in storage.faults().get("history.behind", ""))
        write(storage, 2, 3)
        assert not storage.wait_written(2, 0.0)
        slow_indexes.set()
        assert storage.wait_written(3, PATIENCE_S)
        until(lambda: not storage.faults())
        assert "history.indexed" in [event.key for event in storage.events_pending()]
    assert (seqs(path), version(path)) == ([1, 2, 3], SCHEMA_VERSION)


def test_a_history_is_read_while_its_indexes_are_built(path: Path, slow_indexes: threading.Event) -> None:
    with opened(path) as (storage, _):
        until(lambda: "history.behind" in storage.faults())
        assert len(export_run(path)) == 1


def test_an_end_while_indexes_are_built_loses_no_tick(path: Path, slow_indexes: threading.Event) -> None:
    storage = Storage(History.at(path), HandClock())
    storage.open()
    until(lambda: "history.behind" in storage.faults())
    write(storage, 2, 3)
    assert storage.close(PATIENCE_S)
    assert (seqs(path), version(path)) == ([1, 2, 3], USABLE_VERSION)
    slow_indexes.set()
    with opened(path) as (storage, first):
        assert first == 4
    assert version(path) == SCHEMA_VERSION


def test_a_disk_without_room_for_indexes_still_takes_ticks(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(db: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with opened(path):
        pass
    without_indexes(path)
    migrations = schema.MIGRATIONS
    monkeypatch.setattr(schema, "MIGRATIONS", (*migrations[:-1], fails))
    monkeypatch.setattr(storage_module, "THIN_EVERY_TICKS", 2)
    with opened(path) as (storage, first):
        write(storage, first)
        assert storage.wait_written(first, PATIENCE_S)
        until(lambda: "history.not_indexed" in [event.key for event in storage.events_pending()])
        monkeypatch.setattr(schema, "MIGRATIONS", migrations)  # there is room again
        write(storage, first + 1, first + 2)
    assert (seqs(path), version(path)) == ([first, first + 1, first + 2], SCHEMA_VERSION)


def test_a_failed_migration_leaves_the_old_version(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(db: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(schema, "MIGRATIONS", (schema.create_tables, fails))
    with pytest.raises(sqlite3.OperationalError):
        connect(path, 1.0)
    assert rows(path, "PRAGMA user_version") == [(0,)]
    assert rows(path, "SELECT name FROM sqlite_master") == []


def test_the_writer_of_an_existing_history_needs_no_sqlite_utils(path: Path) -> None:
    with opened(path):
        pass
    code = (
        "import sys; from pathlib import Path; from edge.storage import Storage, Outbox\n"
        "from edge.storage.file import FREE_SHARE, RESERVED_BYTES, connect; connect(Path(sys.argv[1]), 1.0)\n"
        "assert 'sqlite_utils' not in sys.modules and 'edge.storage.schema' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], cwd=Path(__file__).parents[3], check=True)


def test_the_outbox_follows_the_history_to_its_new_file(path: Path) -> None:
    with opened(path) as (storage, _):
        write(storage, 1, 2)
        assert storage.wait_written(2, PATIENCE_S)
        with closing(Outbox(path, "g")) as outbox:
            old = [message.id for message in outbox.pending(10)]
            path.unlink()
            write(storage, 3, 4)
            assert storage.wait_written(4, PATIENCE_S)
            outbox.acknowledge(old)  # numbers that the new file gave to other messages
            assert [json.loads(message.payload)["seq"] for message in outbox.pending(10)] == [3, 4]
