"""The courses and events that the page reads."""

from pathlib import Path

import pytest
from history_records import HandClock, History, tick

from edge.core.errors import DataError, RequestError
from edge.page.history import COLUMNS, course, events, span
from edge.storage import Session, Storage


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "history.db"
    storage = Storage(History.at(file), HandClock(0.0), Session())
    storage.open()
    for seq in range(1, 31):
        storage.write(tick(seq))
    assert storage.close(10.0)
    return file


def test_a_course_has_every_tick_where_there_is_room_and_means_where_there_is_not(path: Path) -> None:
    first, last = span(path)["first_utc"], span(path)["newest_utc"]
    assert span(path)["free_mb"] > 0
    whole = course(path, first, last + 1.0, 1000)
    assert tuple(whole) == COLUMNS
    assert len(whole["utc"]) == 30
    assert whole["utc"] == sorted(whole["utc"])
    few = course(path, first, last + 1.0, 5)
    assert len(few["utc"]) == 5
    assert min(whole["air_c"]) == min(few["air_low_c"])
    assert max(whole["air_c"]) == max(few["air_high_c"])
    means = [sum(whole["air_c"][k : k + 6]) / 6 for k in range(0, 30, 6)]
    assert few["air_c"] == pytest.approx(means, abs=2e-3)


def test_where_nothing_is_recorded_the_columns_are_empty(path: Path) -> None:
    assert course(path, 1.0, 2.0, 10) == {name: [] for name in COLUMNS}


@pytest.mark.parametrize(("first", "last"), [(5.0, 5.0), (6.0, 5.0), (0.0, 1e10)])
def test_a_span_that_is_none_is_refused(path: Path, first: float, last: float) -> None:
    with pytest.raises(RequestError, match="from_utc"):
        course(path, first, last, 10)


def test_a_missing_history_is_told_and_not_made(tmp_path: Path) -> None:
    file = tmp_path / "history.db"
    for call in (
        lambda: span(file),
        lambda: events(file, None, ("alarm",), 5),
        lambda: course(file, 0, 1, 2),
    ):
        with pytest.raises(DataError, match=r"history\.db"):
            call()
    assert list(tmp_path.iterdir()) == []
