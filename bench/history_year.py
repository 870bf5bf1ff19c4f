"""python -m bench.history_year: every query of the product on a year of history, with and without indexes.

Some hours of the default rig in lock-step are recorded once and repeated over a year at 60 s steps, written
by the product's own row code. `raw` keeps every tick of the year; `thinned` is the same file after retention
at default settings. CPU time of the thread, so that other processes of the machine count little.
"""

import argparse
import os
import platform
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from edge.assistant.llm.ledger import ToolError
from edge.assistant.llm.sql_tool import DEADLINE_S, SqlTool
from edge.assistant.why.ask_history import why
from edge.config import loading as config
from edge.config.settings import HistorySettings
from edge.core.messages import Event, Severity, TickRecord
from edge.storage import Outbox, Session
from edge.storage.archive import Archive
from edge.storage.file import SliceCheck, connect
from edge.storage.retention import thin
from edge.storage.runs import events_between, export_run, export_stretches
from edge.storage.schema import INDEXES
from edge.storage.schema_version import USABLE_VERSION, VIEWS
from edge.storage.tick_rows import insert_ticks
from training.lab import Lab

STEP_S = 60.0
DAY_S = 86400.0
FIRST_UTC = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
BATCH = 5000  # ticks in one transaction of the builder
EVENT_EVERY_TICKS = 30  # one made-up warning, and its end at the next tick
REPEATS = 5
TIME_OF = {"v_ten_minutes": "start_utc", "v_skill": "hour_utc"}  # other views call it utc
Query = Callable[[], object]


def recorded_ticks(hours: float) -> list[TickRecord]:
    """Record ticks of the default rig on a virtual board."""
    with Lab(config.default()) as lab:
        lab.run(minutes=60.0 * hours)
    return lab.history


def year_of(template: Sequence[TickRecord], days: float, first_seq: int = 1) -> Iterator[list[TickRecord]]:
    """Yield the template again and again, in batches."""
    end = first_seq + round(days * DAY_S / STEP_S)
    for first in range(first_seq, end, BATCH):
        yield [move(template[seq % len(template)], seq) for seq in range(first, min(first + BATCH, end))]


def move(record: TickRecord, seq: int) -> TickRecord:
    """Return a tick as number `seq` of the year."""
    utc = FIRST_UTC + STEP_S * seq
    events = tuple(replace(event, utc=utc) for event in record.events)
    if seq % EVENT_EVERY_TICKS < 2:
        over = ".over" if seq % EVENT_EVERY_TICKS else ""
        events += (Event(f"reading.not_good{over}", Severity.WARNING, "spike", 0.0, utc),)
    return replace(record, seq=seq, utc=utc, time_s=STEP_S * seq, events=events)


def build(path: Path, template: Sequence[TickRecord], days: float, first_seq: int = 1) -> None:
    """Write the year, or its days from a tick on, as a daemon before the indexes would have left it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for suffix in ("", "-wal", "-shm"):
        Path(f"{path}{suffix}").unlink(missing_ok=True)
    with closing(connect(path, 1.0)) as connection:
        for index in INDEXES:
            connection.execute(f"DROP INDEX {index}")
        connection.execute(f"PRAGMA user_version = {USABLE_VERSION}")
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute(
            "INSERT INTO sessions (session, first_seq, started_utc, ended_utc, boot_id, started_time_s)"
            " VALUES (1, 1, ?, ?, '', 0)",
            (FIRST_UTC, FIRST_UTC + days * DAY_S),
        )
        for records in year_of(template, days, first_seq):
            connection.execute("BEGIN")
            insert_ticks(connection, records, session=1)
            connection.execute("COMMIT")


def thin_all(path: Path) -> int:
    """Retention at default settings until nothing is left to do. Returns the number of chunks."""
    chunks, more = 0, True
    with closing(connect(path, 1.0)) as connection:
        connection.execute("PRAGMA synchronous = OFF")
        while more:
            more, _ = thin(connection, HistorySettings())
            chunks += 1
    return chunks


def queries(path: Path) -> Iterator[tuple[str, Query]]:
    """Every query of the product, by name. Those that change rows take their changes back."""
    with closing(sqlite3.connect(path)) as connection:
        last_seq, last_utc = connection.execute("SELECT max(seq), max(utc) FROM ticks").fetchone()
    # Not the newest rows, which were written last and stand in the cache.
    middle = max(last_utc - 15 * DAY_S, FIRST_UTC + 7200.0)
    tool = SqlTool(path, lambda: last_utc + 30.0)

    def sql(query: str) -> Query:
        return lambda: tool.call({"query": query})

    yield "start: open", lambda: _open(path).close()
    yield "start: whole quick_check, as it was", lambda: _quick_check(path)
    yield "check: one slice, after a tick", SliceCheck(path, 1.0).step
    yield "retention: a round with nothing to do", lambda: _thin(path, 36_500.0)
    yield "retention: a chunk", lambda: _thin(path, 29.0)
    yield "why, the newest tick", lambda: why(path, None, None)
    yield "why --at", lambda: why(path, middle, None)
    for view in VIEWS:
        key = TIME_OF.get(view, "utc")
        yield f"sql: {view} ORDER BY {key} DESC", sql(f"SELECT * FROM {view} ORDER BY {key} DESC LIMIT 20")
        yield f"sql: {view} ORDER BY {key}", sql(f"SELECT * FROM {view} ORDER BY {key} LIMIT 20")
        bounds = f"{key} BETWEEN {middle} AND {middle + 3600.0}"
        yield f"sql: {view}, an hour", sql(f"SELECT * FROM {view} WHERE {bounds} ORDER BY {key} LIMIT 20")
    yield "outbox: 500 messages, payloads made", lambda: _outbox(path, lambda box: box.pending(500))
    yield "outbox: depth", lambda: _outbox(path, Outbox.depth)
    yield "outbox: resend of a day", lambda: _resend(path, last_seq - 1439, last_seq)
    yield "events of a day", lambda: events_between(path, middle, middle + DAY_S)
    yield "export of a day, by time", lambda: export_run(path, since_utc=middle, until_utc=middle + DAY_S)
    yield (
        "export of a day, by numbers",
        lambda: export_run(path, first_seq=last_seq - 1439, last_seq=last_seq),
    )
    yield "nightly diagnosis: its 14 days", lambda: export_stretches(path, last_utc - 14 * DAY_S)


def _open(path: Path) -> Archive:
    archive = Archive(path, Session(), 0.0)
    archive.open()
    return archive


def _quick_check(path: Path) -> None:
    with closing(connect(path, 1.0)) as connection:
        assert connection.execute("PRAGMA quick_check(1)").fetchone() == ("ok",)


def _thin(path: Path, downsample_after_days: float) -> None:
    with closing(_Undone(path)) as connection:
        settings = replace(
            HistorySettings(), retention_days=36_500.0, downsample_after_days=downsample_after_days
        )
        thin(connection, settings)


def _outbox(path: Path, ask: Callable[[Outbox], object]) -> None:
    with closing(Outbox(path, "bench")) as box:
        ask(box)


def _resend(path: Path, first: int, last: int) -> None:
    _outbox(path, lambda box: box.resend(first, last))
    with closing(connect(path, 1.0)) as connection:
        connection.execute("DELETE FROM outbox WHERE is_resend")


class _Undone(sqlite3.Connection):
    """A connection whose transactions are rolled back instead of committed."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, isolation_level=None)

    def execute(self, statement: str, *values: object) -> sqlite3.Cursor:
        return super().execute("ROLLBACK" if statement == "COMMIT" else statement, *values)  # type: ignore[arg-type]


def cpu_ms(query: Query) -> str:
    """Largest of some repeats, warm; `interrupted` where the language model's query was ended."""
    worst = 0.0
    for _ in range(REPEATS):
        began = time.thread_time()
        try:
            query()
        except ToolError as error:
            return f"{error}".split()[-1] if "interrupted" in str(error) else str(error)
        worst = max(worst, time.thread_time() - began)
        if worst > 2 * DEADLINE_S:
            break
    return f"{1e3 * worst:.1f}"


def measure(path: Path) -> dict[str, str]:
    """By name of the query."""
    return {name: cpu_ms(query) for name, query in queries(path)}


def head() -> str:
    """Code and machine."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    return f"commit {commit}; python {platform.python_version()}, sqlite {sqlite3.sqlite_version}; {machine}"


def index(path: Path) -> float:
    """Run the migration that adds the indexes [s of CPU]."""
    began = time.thread_time()
    with closing(_open(path)) as archive:
        archive.finish_migration()
    return time.thread_time() - began


def whole_check(path: Path) -> tuple[int, float]:
    """Slices until the whole file has been read: how many, and the slowest [ms of CPU]."""
    slices, worst = 0, 0.0
    with closing(_open(path)) as archive:
        more = True
        while more:
            began = time.thread_time()
            more = archive.check_slice()
            worst, slices = max(worst, time.thread_time() - began), slices + 1
    return slices, 1e3 * worst


def report(path: Path, days: float, hours: float) -> Iterator[str]:
    """Yield the tables, line by line as they come."""
    yield head()
    began = time.perf_counter()
    build(path, recorded_ticks(hours), days)
    size = path.stat().st_size / 1e6
    built_s = time.perf_counter() - began
    yield f"{days:g} days from {hours:g} h of the default rig: {size:.0f} MB, {built_s:.0f} s to make"
    without = measure(path)
    yield f"the migration that adds the indexes: {index(path):.1f} s of CPU"
    with_indexes = measure(path)
    yield "check: {} slices read the whole file, the slowest {:.1f} ms".format(*whole_check(path))
    yield f"retention at default settings: {thin_all(path)} chunks"
    thinned = measure(path)
    yield ""
    yield f"{f'CPU time, largest of {REPEATS}, warm [ms]':40} {'raw, before':>12} {'raw':>12} {'thinned':>12}"
    for name in without:
        yield f"{name:40} {without[name]:>12} {with_indexes[name]:>12} {thinned[name]:>12}"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.history_year", description=__doc__)
    parser.add_argument("--days", type=float, default=365.0)
    parser.add_argument("--hours", type=float, default=12.0, help="of the rig that are repeated")
    parser.add_argument("--file", type=Path, default=Path("out/bench/history_year.db"), help="made anew")
    arguments = parser.parse_args()
    print(f"python -m bench.history_year {' '.join(sys.argv[1:])}")
    for line in report(arguments.file, arguments.days, arguments.hours):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
