"""The courses and events that the page reads: in the last month of ticks, before it, and where both meet."""

import sqlite3
import tracemalloc
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from history_records import START_UTC, History, add, store, tick

from edge.core.errors import DataError, RequestError
from edge.core.messages import Event, Severity, TickRecord
from edge.page import courses
from edge.page.courses import COLUMNS, Courses
from edge.page.history import events, span
from edge.storage.file import connect
from edge.storage.retention import thin
from edge.storage.runs import name_run

DAY_S = 86_400.0
TICKS = range(1, 31)


def record(path: Path, ticks: Iterable[TickRecord]) -> None:
    """Insert ticks, as many as a test wants, in one transaction."""
    with closing(connect(path, 1.0)) as connection:
        add(connection, *ticks)


def at(seq: int) -> float:
    return START_UTC + 60.0 * seq


def thin_until(path: Path, seq: int) -> None:
    """Make ten-minute rows of all ticks before one. The newest tick decides what is old."""
    with closing(connect(path, 1.0)) as connection:
        newest = connection.execute("SELECT min(utc), max(utc) FROM ticks WHERE seq > 0").fetchone()
        while thin(connection, History.at(path, downsample_after_days=(newest[0] - at(seq)) / DAY_S))[0]:
            pass


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "history.db"
    store(file, *(tick(seq) for seq in TICKS))
    return file


def test_a_course_has_every_tick_where_there_is_room_and_means_where_there_is_not(path: Path) -> None:
    first, last = at(1), at(31)
    whole = Courses(path).between(first, last, 1000)
    assert tuple(whole) == COLUMNS
    assert whole["utc"] == [at(seq) for seq in TICKS]
    assert whole["air_c"] == whole["air_low_c"] == whole["air_high_c"]
    assert whole["heater"] == pytest.approx([0.05 * (seq % 21) for seq in TICKS])
    few = Courses(path).between(first, last, 6)
    assert 3 <= len(few["utc"]) <= 6
    begins = [whole["utc"].index(utc) for utc in few["utc"]]
    for begin, end, place in zip(begins, [*begins[1:], 30], range(30), strict=False):
        air = whole["air_c"][begin:end]
        found = few["air_c"][place], few["air_low_c"][place], few["air_high_c"][place]
        assert found == pytest.approx((sum(air) / len(air), min(air), max(air)), abs=1e-3)
        heater = whole["heater"][begin:end]
        assert few["heater"][place] == pytest.approx(sum(heater) / len(heater), abs=1e-3)


def test_where_nothing_is_recorded_the_columns_are_empty(path: Path) -> None:
    assert Courses(path).between(-5.0, 2.0, 10) == {name: [] for name in COLUMNS}


@pytest.mark.parametrize(("first", "last"), [(5.0, 5.0), (6.0, 5.0), (0.0, 1e10)])
def test_a_span_that_is_none_is_refused(path: Path, first: float, last: float) -> None:
    with pytest.raises(RequestError, match="from_utc"):
        Courses(path).between(first, last, 10)


@pytest.mark.parametrize("days", [7.0, 10.5, 20.0, 300.0])
def test_the_last_month_is_drawn_however_long_the_course(tmp_path: Path, days: float) -> None:
    """The page's chart of 7 days asks for 10.5, so that it can be dragged at once."""
    file = tmp_path / "history.db"
    record(file, (tick(seq, utc=START_UTC + 3600.0 * seq) for seq in range(1, 24 * 20)))
    last = START_UTC + 20 * DAY_S
    found = Courses(file).between(last - days * DAY_S, last, 1000)
    assert found["utc"][-1] > last - DAY_S
    assert len(found["utc"]) >= min(days, 20.0)
    assert found["utc"] == sorted(found["utc"])


def test_no_course_has_more_rows_than_asked_or_rows_from_outside(path: Path) -> None:
    for points in (2, 3, 7, 15, 16, 17, 29):
        for first in range(8):
            for span_s in (60.0 * points, 301.0, 1799.0):
                found = Courses(path).between(at(first), at(first) + span_s, points)["utc"]
                assert len(found) <= points
                assert all(at(first) <= utc < at(first) + span_s for utc in found)


@pytest.mark.parametrize("points", [6, 22])
@pytest.mark.parametrize("until", [130, 255, 301])
def test_a_month_later_a_long_course_still_has_the_same_means_lows_and_highs(
    tmp_path: Path, until: int, points: int
) -> None:
    """Retention stands in the middle of a window and of a bucket, or behind all of them."""
    file = tmp_path / "history.db"
    # The heater is on for a while once, so that means of windows differ, and a window has fewer ticks.
    seqs = [seq for seq in range(1, 301) if not 63 <= seq < 68]
    record(file, (tick(seq) for seq in seqs))
    record(file, [tick(60 * 24 * 40)])
    asked = (at(0), at(301), points)
    before = Courses(file).between(*asked)
    thin_until(file, until)
    with closing(sqlite3.connect(file)) as db:
        assert db.execute("SELECT count(*) FROM ticks").fetchone()[0] < 280
    after = Courses(file).between(*asked)
    for name in COLUMNS[1:]:
        assert after[name] == pytest.approx(before[name], abs=2e-3), name


def test_ticks_of_a_named_run_stand_in_their_place_among_older_rows(tmp_path: Path) -> None:
    file = tmp_path / "history.db"
    record(file, (tick(seq) for seq in range(1, 301)))
    name_run(file, "steps", "test", 101, 140, {})
    record(file, [tick(60 * 24 * 40)])
    thin_until(file, 301)
    for points in (1000, 100, 40):
        found = Courses(file).between(at(0), at(301), points)["utc"]
        assert found == sorted(found)
    fine = Courses(file).between(at(0), at(301), 1000)["utc"]
    assert {at(seq) for seq in range(101, 141)} <= set(fine)
    assert len(fine) <= 40 + 31


def test_retention_in_the_middle_of_a_look_neither_hides_nor_doubles_a_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "history.db"
    record(file, (tick(seq) for seq in range(1, 301)))
    record(file, [tick(60 * 24 * 40)])
    asked = (at(0), at(301), 30)
    expected, windows = Courses(file).between(*asked), courses._windows

    def windows_then_retention(*given: Any) -> Any:
        found = windows(*given)
        thin_until(file, 301)
        return found

    monkeypatch.setattr(courses, "_windows", windows_then_retention)
    with closing(connect(file, 1.0)):  # the daemon has it open
        assert Courses(file).between(*asked) == expected


def test_ticks_of_imported_runs_are_not_of_this_rig(path: Path) -> None:
    record(path, [tick(-3, utc=at(5) + 30.0)])
    assert Courses(path).between(at(0), at(31), 1000)["utc"] == [at(seq) for seq in TICKS]


def test_later_looks_show_what_is_new_and_read_no_older_row_again(path: Path) -> None:
    kept, asked = Courses(path), (at(0), at(61), 2000)
    kept.between(*asked)
    record(path, (tick(seq) for seq in range(31, 61)))
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("UPDATE ticks SET reference_c = 99.0 WHERE seq = 2")  # nobody does; it shows who reads it
    assert kept.between(*asked)["utc"] == [at(seq) for seq in range(1, 61)]
    assert max(kept.between(*asked)["reference_c"]) == 26.0
    assert max(Courses(path).between(*asked)["reference_c"]) == 99.0


@pytest.mark.parametrize("looks_between", [False, True])
def test_ticks_of_a_clock_that_went_back_are_shown(path: Path, looks_between: bool) -> None:
    kept = Courses(path)
    asked = (at(0), at(61), 2000)
    kept.between(*asked)
    record(path, (tick(seq, utc=at(seq - 25) + 30.0) for seq in range(31, 36)))
    if looks_between:
        assert len(kept.between(*asked)["utc"]) == 35
    # It has caught up before somebody looks again.
    record(path, (tick(seq, utc=at(seq)) for seq in range(36, 61)))
    assert kept.between(*asked) == Courses(path).between(*asked)
    assert len(kept.between(*asked)["utc"]) == 60


@pytest.mark.parametrize("count", [10, 90])
def test_another_history_in_the_same_place_is_read_anew(path: Path, tmp_path: Path, count: int) -> None:
    kept = Courses(path)
    asked = (at(0), at(91), 2000)
    kept.between(*asked)
    other = tmp_path / "other.db"
    store(other, *(tick(seq, reference_c=18.0) for seq in range(1, count + 1)))
    other.replace(path)
    assert set(kept.between(*asked)["reference_c"]) == {18.0}


def test_a_backup_in_the_place_of_its_history_is_read_anew(path: Path, tmp_path: Path) -> None:
    backup = tmp_path / "backup.db"
    with closing(sqlite3.connect(path)) as db:
        db.execute("VACUUM INTO ?", (str(backup),))
    record(path, (tick(seq) for seq in range(31, 61)))
    kept, asked = Courses(path), (at(0), at(91), 2000)
    kept.between(*asked)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    backup.replace(path)
    record(path, [tick(31, utc=at(80))])
    assert kept.between(*asked)["utc"] == [*(at(seq) for seq in TICKS), at(80)]


def test_what_is_kept_has_a_bound(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(path, (tick(seq) for seq in range(31, 3001)))
    monkeypatch.setattr(courses, "ROWS_MAX", 100)
    kept, asked = Courses(path), (at(0), at(2001), 2000)
    expected = Courses(path).between(*asked)
    tracemalloc.start()
    try:
        assert kept.between(*asked) == expected
        assert kept.between(*asked) == expected
        used, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert used < 2e5  # all rows of this course take 9e5


def test_a_drag_reads_what_is_missing_on_both_sides(path: Path) -> None:
    kept = Courses(path)
    for first, last in ((10, 20), (9, 21), (5, 15), (15, 25)):  # buckets of 0.44 s, all of them
        asked = (at(first) - 1.0, at(last), 2000)
        assert kept.between(*asked) == Courses(path).between(*asked)
        assert len(kept.between(*asked)["utc"]) == last - first


def test_after_a_clock_that_ran_ahead_the_newest_event_still_comes_first(tmp_path: Path) -> None:
    file = tmp_path / "history.db"
    for seq, ahead_s in ((1, 0.0), (2, 86_400.0), (3, 0.0)):
        utc = START_UTC + 60.0 * seq + ahead_s
        store(file, tick(seq, utc=utc, events=(Event("trip", Severity.ALARM, f"number {seq}", 0.0, utc),)))
    found = events(file, None, ("alarm",), 2)
    assert [event["text"] for event in found] == ["number 3", "number 2"]
    before = events(file, START_UTC + 181.0, ("alarm",), 5)
    assert [event["text"] for event in before] == ["number 3", "number 1"]
    assert events(file, None, ("warning",), 5) == []
    assert span(file)["free_mb"] > 0


def test_a_missing_history_is_told_and_not_made(tmp_path: Path) -> None:
    file = tmp_path / "history.db"
    for call in (
        lambda: span(file),
        lambda: events(file, None, ("alarm",), 5),
        lambda: Courses(file).between(0, 1, 2),
    ):
        with pytest.raises(DataError, match=r"history\.db"):
            call()
    assert list(tmp_path.iterdir()) == []
