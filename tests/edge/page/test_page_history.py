"""The events that the page reads; its courses are in `test_courses.py`."""

from pathlib import Path

import pytest
from history_records import START_UTC, store, tick

from edge.core.errors import DataError
from edge.core.messages import Event, Severity
from edge.page.courses import Courses
from edge.page.history import events, span


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
