"""No query of the product reads a year of ticks or events: each is answered by a key or an index."""

import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from history_records import START_UTC, History, eventful_tick, store, tick

from edge.assistant.llm.sql_tool import SqlTool
from edge.assistant.why.ask_history import why
from edge.page.courses import Courses
from edge.page.history import events
from edge.storage import Outbox, Session
from edge.storage.archive import Archive
from edge.storage.run_rows import reading, run_text
from edge.storage.runs import events_between, export_run, export_stretches, name_run
from edge.storage.schema_version import VIEWS

LARGE = ("ticks", "events", "readings", "decisions", "forecasts", "changes", "outbox")
ALIASES = ("t", "f", "r", "d", "c")  # of the views, edge/storage/schema.py
UNINDEXED = re.compile(rf"SCAN ({'|'.join(LARGE + ALIASES)})$")
OPEN_RANGE = re.compile(r"SEARCH \w+ USING INTEGER PRIMARY KEY \(rowid[<>]\?\)$")  # all rows but few
NOON = START_UTC + 600.0


@pytest.fixture
def history(tmp_path: Path) -> Path:
    path = tmp_path / "history.db"
    store(path, *(eventful_tick(seq) if seq % 10 == 0 else tick(seq) for seq in range(1, 40)))
    name_run(path, "steps", "test", 3, 9, {})
    return path


@pytest.fixture
def statements(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Whatever any connection executes from here on, values filled in."""
    seen: list[str] = []
    connect = sqlite3.connect

    def tracing(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connection = connect(*arguments, **options)
        connection.set_trace_callback(seen.append)
        return connection

    monkeypatch.setattr(sqlite3, "connect", tracing)
    return seen


def is_slow(text: str, plan: list[str]) -> bool:
    """Return whether a statement planned so reads all rows of a large table."""
    if re.search(r"FROM outbox WHERE is_resend = [01] ORDER BY id LIMIT", text):
        return False  # from its front; before a new message stand RESENDS_MAX at most
    if "FROM outbox WHERE is_resend = 1" in text:  # counted for a request alone
        return False
    if "FROM events WHERE severity IN" in text and "ORDER BY seq DESC, number DESC LIMIT" in text:
        return False  # from its end until there are enough: 6 ms for a year without any
    is_sorted = "USE TEMP B-TREE FOR ORDER BY" in plan  # a LIMIT ends nothing early then
    return any(UNINDEXED.match(line) or (is_sorted and OPEN_RANGE.match(line)) for line in plan)


def plan_of(connection: sqlite3.Connection, text: str) -> list[str]:
    return [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {text}")]


def sql(query: str) -> Callable[[Path], object]:
    return lambda path: SqlTool(path, lambda: NOON).call({"query": query})


def archive(action: Callable[[Archive], object]) -> Callable[[Path], object]:
    def run(path: Path) -> None:
        opened = Archive(path, Session(), 0.0)
        opened.open()
        action(opened)
        opened.close()

    return run


def outbox(action: Callable[[Outbox], object]) -> Callable[[Path], object]:
    def run(path: Path) -> None:
        with closing(Outbox(path, "g")) as box:
            action(box)

    return run


def _look_twice(courses: Courses) -> None:
    for _ in range(2):
        courses.between(START_UTC, NOON, 100)


def sql_queries() -> Iterator[tuple[str, Callable[[Path], object]]]:
    for view in VIEWS:
        if view not in (
            "v_gaps",
            "v_skill",
            "v_ten_minutes",
        ):  # few rows, or in the order of time by their key
            yield f"{view} newest", sql(f"SELECT * FROM {view} ORDER BY utc DESC LIMIT 20")
            yield f"{view} oldest", sql(f"SELECT * FROM {view} ORDER BY utc")
            yield f"{view} span", sql(f"SELECT * FROM {view} WHERE utc BETWEEN {NOON} AND {NOON + 60.0}")


PRODUCT: dict[str, Callable[[Path], object]] = {
    "start": archive(lambda _: None),
    "append": archive(lambda a: a.append([tick(50)], [], 50, NOON)),
    "check": archive(Archive.check_slice),
    "thin, nothing old": archive(lambda a: a.thin(History("", downsample_after_days=30.0))),
    "thin, all old": archive(lambda a: a.thin(History("", 1e-9, 1e-9))),
    "why": lambda path: why(path, None, None),
    "why --at": lambda path: why(path, NOON, None),
    "outbox pending": outbox(lambda box: box.pending(10)),
    "outbox acknowledge": outbox(lambda box: box.acknowledge([m.id for m in box.pending(3)])),
    "outbox resend": outbox(lambda box: box.resend(3, 9)),
    "events": lambda path: events_between(path, NOON, NOON + 600.0),
    "export by time": lambda path: export_run(path, since_utc=NOON),
    "export to a time": lambda path: export_run(path, until_utc=NOON),
    "export by number": lambda path: export_run(path, first_seq=3, last_seq=9),
    "export by name": lambda path: export_run(path, name="steps"),
    "export of the page": lambda path: list(run_text(path, NOON, NOON + 600.0, partial(reading, path))),
    "course of the page": lambda path: Courses(path).between(NOON, NOON + 600.0, 100),
    "course of the page, looked at again": lambda path: _look_twice(Courses(path)),
    "events of the page": lambda path: events(path, None, ("alarm",), 5),
    "older events of the page": lambda path: events(path, NOON, ("alarm",), 5),
    "nightly diagnosis": lambda path: export_stretches(path, since_utc=NOON),
    **dict(sql_queries()),
}


@pytest.mark.parametrize("name", PRODUCT)
def test_no_query_of_the_product_scans_a_large_table(name: str, history: Path, statements: list[str]) -> None:
    if name.startswith("thin"):
        with closing(sqlite3.connect(history)) as connection, connection:  # times that are believed, and old
            connection.execute("UPDATE ticks SET utc = utc - 86400 WHERE seq < 9")
    PRODUCT[name](history)
    statements = [text.replace("< Inf", "< 9e999") for text in statements]
    asked = [text for text in statements if re.match(r"\s*(SELECT|DELETE|INSERT|UPDATE)", text)]
    assert any(re.search(r"\b(ticks|events|outbox|v_\w+)\b", text) for text in asked)
    with closing(sqlite3.connect(history)) as connection:
        assert [text for text in asked if is_slow(text, plan_of(connection, text))] == []


@pytest.mark.parametrize("name", ["why --at", "events", "export by time", "v_forecasts newest"])
def test_without_the_indexes_the_same_look_finds_a_scan(
    name: str, history: Path, statements: list[str]
) -> None:
    """Else the check above could not fail."""
    with closing(sqlite3.connect(history)) as connection:
        connection.execute("DROP INDEX ticks_by_utc")
        connection.execute("DROP INDEX events_by_utc")
    PRODUCT[name](history)
    with closing(sqlite3.connect(history)) as connection:
        asked = [text for text in statements if text.startswith("SELECT")]
        assert [text for text in asked if is_slow(text, plan_of(connection, text))]
