"""Old ticks are thinned, older rows go, and a clock that is wrong deletes nothing."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from history_records import START_UTC, HandClock, History, add, tick

from edge.core.messages import Event, ForecastSkill, Reading, ReadingQuality, Severity, TickRecord
from edge.storage import Outbox, Storage, retention
from edge.storage.file import connect
from edge.storage.runs import name_run

DAY_S = 86400.0
LIMITS = History("", downsample_after_days=1.0, retention_days=10.0)


@pytest.fixture
def history(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[sqlite3.Connection]:
    monkeypatch.setattr(retention, "CLOCK_TICKS", 3)
    with closing(connect(path, 5.0)) as connection:
        yield connection


def at(seq: int, utc_s: float, **values: object) -> TickRecord:
    return tick(seq, utc=START_UTC + utc_s, **values)


def recent(first_seq: int, utc_s: float) -> list[TickRecord]:
    """As many ticks as it takes for their time to be believed."""
    return [at(first_seq + i, utc_s + i) for i in range(retention.CLOCK_TICKS)]


def seqs(history: sqlite3.Connection, table: str = "ticks") -> list[int]:
    return [seq for (seq,) in history.execute(f"SELECT DISTINCT seq FROM {table} ORDER BY seq")]


def thin_all(history: sqlite3.Connection) -> int:
    """Returns how many messages were dropped."""
    dropped = 0
    more = True
    while more:
        more, now_dropped = retention.thin(history, LIMITS)
        dropped += now_dropped
    return dropped


def windows(history: sqlite3.Connection, quantity: str) -> list[tuple[float, ...]]:
    return history.execute(
        "SELECT start_utc - ?, rows, mean, low, high FROM ten_minutes WHERE quantity = ? ORDER BY 1",
        (START_UTC, quantity),
    ).fetchall()


def test_an_empty_history_has_nothing_to_thin(history: sqlite3.Connection) -> None:
    assert retention.thin(history, LIMITS) == (False, 0)


@pytest.mark.parametrize(("age_s", "thinned"), [(DAY_S - 1, False), (DAY_S, False), (DAY_S + 1, True)])
def test_a_tick_is_thinned_when_it_is_older_than_the_limit(
    history: sqlite3.Connection, age_s: float, thinned: bool
) -> None:
    add(history, at(1, 0.0), *recent(2, age_s))
    thin_all(history)
    assert (1 not in seqs(history)) == thinned


def test_ticks_become_means_lows_and_highs_of_ten_minutes(history: sqlite3.Connection) -> None:
    # tick() reads 25.0 + 0.1 (seq % 10): 25.1, 25.2, 25.3 in the first window, 25.4 in the second.
    add(history, at(1, 0.0), at(2, 60.0), at(3, 599.0), at(4, 600.0), *recent(5, 2 * DAY_S))
    thin_all(history)
    assert windows(history, "temp_air_c") == [
        (0.0, 3, pytest.approx(25.2), 25.1, 25.3),
        (600.0, 1, 25.4, 25.4, 25.4),
    ]
    assert windows(history, "heater_duty")[0] == (0.0, 3, pytest.approx(0.1), 0.05, pytest.approx(0.15))
    assert windows(history, "fan_on")[0] == (0.0, 3, pytest.approx(2 / 3), 0.0, 1.0)
    assert [row[2] for row in windows(history, "reference_c")] == [26.0, 26.0]


def test_no_row_of_a_thinned_tick_stays(history: sqlite3.Connection) -> None:
    add(history, at(1, 0.0), *recent(2, 2 * DAY_S))
    thin_all(history)
    for table in ("ticks", "readings", "decisions", "forecasts", "outbox"):
        assert seqs(history, table) == [2, 3, 4]


def test_readings_that_were_not_good_are_in_no_mean(history: sqlite3.Connection) -> None:
    spike = {"temp_air": Reading("temp_air", 79.0, 0.0, ReadingQuality.SPIKE)}
    add(history, at(1, 0.0), at(2, 60.0, readings=spike), *recent(3, 2 * DAY_S))
    thin_all(history)
    assert windows(history, "temp_air_c") == [(0.0, 1, 25.1, 25.1, 25.1)]


def test_a_window_thinned_in_chunks_is_the_same_as_in_one(
    history: sqlite3.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "CHUNK_ROWS", 2)
    add(history, *(at(seq, 60.0 * seq) for seq in range(1, 8)), *recent(8, 2 * DAY_S))
    thin_all(history)
    assert seqs(history) == [8, 9, 10]
    assert windows(history, "temp_air_c") == [(0.0, 7, pytest.approx(25.4), 25.1, pytest.approx(25.7))]


def test_one_call_thins_one_chunk(history: sqlite3.Connection, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "CHUNK_ROWS", 2)
    add(history, *(at(seq, 60.0 * seq) for seq in range(1, 8)), *recent(8, 2 * DAY_S))
    more, _ = retention.thin(history, LIMITS)
    assert more
    assert seqs(history) == list(range(3, 11))


def test_events_stay_longer_than_their_ticks(history: sqlite3.Connection) -> None:
    event = Event("board.link_lost", Severity.ALARM, "silent", 0.0, START_UTC)
    add(history, at(1, 0.0, events=(event,)), *recent(2, 2 * DAY_S))
    thin_all(history)
    assert seqs(history, "events") == [1]
    add(history, *recent(5, 11 * DAY_S))
    thin_all(history)
    assert seqs(history, "events") == []


def test_windows_older_than_the_retention_go(history: sqlite3.Connection) -> None:
    add(history, at(1, 0.0), at(2, 5 * DAY_S), *recent(3, 12 * DAY_S))
    thin_all(history)
    assert [row[0] for row in windows(history, "temp_air_c")] == [5 * DAY_S]


def test_the_ticks_of_a_named_run_are_kept(history: sqlite3.Connection, path: Path) -> None:
    add(history, *(at(seq, 60.0 * seq) for seq in range(1, 7)), *recent(7, 20 * DAY_S))
    name_run(path, "steps", "train", 3, 4, {})
    thin_all(history)
    assert seqs(history) == [3, 4, 7, 8, 9]


@pytest.mark.parametrize("wrong_s", [-50 * 365 * DAY_S, 50 * 365 * DAY_S])
def test_a_clock_that_stood_wrong_for_a_while_deletes_nothing(
    history: sqlite3.Connection, wrong_s: float
) -> None:
    right = [at(seq, 60.0 * seq) for seq in range(1, 5)]
    wrong = [at(seq, wrong_s + 60.0 * seq) for seq in (5, 6)]  # fewer than it takes to be believed
    add(history, *right, *wrong)
    thin_all(history)
    assert seqs(history) == [1, 2, 3, 4, 5, 6]
    add(history, *(at(seq, 60.0 * seq) for seq in (7, 8, 9, 10)))
    thin_all(history)
    assert seqs(history) == list(range(1, 11))


@pytest.mark.parametrize("wrong_s", [74 * 365 * DAY_S, -56 * 365 * DAY_S], ids=["2099", "1970"])
@pytest.mark.parametrize("rows", [1, 7], ids=["one tick", "more than a chunk"])
def test_a_wrong_date_in_the_middle_holds_up_no_thinning(
    history: sqlite3.Connection, monkeypatch: pytest.MonkeyPatch, wrong_s: float, rows: int
) -> None:
    monkeypatch.setattr(retention, "CHUNK_ROWS", 5)
    wrong = range(4, 4 + rows)
    add(history, *(at(seq, 60.0 * seq + wrong_s * (seq in wrong)) for seq in range(1, 15)))
    add(history, *recent(15, 600.0))
    thin_all(history)
    assert seqs(history) == list(range(1, 18))  # young by their numbers, whatever their date says
    add(history, *recent(18, 2 * DAY_S))
    thin_all(history)
    assert seqs(history) == [18, 19, 20]
    assert sum(row[1] for row in windows(history, "temp_air_c") if 0.0 <= row[0] < DAY_S) == 17 - rows


def test_ticks_before_a_long_time_in_1970_are_not_taken_for_old(history: sqlite3.Connection) -> None:
    add(history, *(at(seq, 60.0 * seq) for seq in range(1, 5)))
    add(history, *recent(5, -56 * 365 * DAY_S))  # believed: it is 1970 now
    thin_all(history)
    assert seqs(history) == list(range(1, 8))


def test_messages_too_old_to_be_sent_are_counted(history: sqlite3.Connection) -> None:
    add(history, at(1, 0.0), at(2, 60.0), *recent(3, 2 * DAY_S))
    assert thin_all(history) == 2
    assert seqs(history, "outbox") == [3, 4, 5]


def test_too_many_messages_drop_the_oldest(
    history: sqlite3.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "OUTBOX_MAX", 2)
    add(history, *recent(1, 0.0), at(4, 9.0))
    assert thin_all(history) == 2
    assert seqs(history, "outbox") == [3, 4]


def test_the_file_gives_space_back(history: sqlite3.Connection) -> None:
    add(history, *(at(seq, 60.0 * seq) for seq in range(1, 1200)), *recent(1200, 5 * DAY_S))
    pages = history.execute("PRAGMA page_count").fetchone()[0]
    thin_all(history)
    for _ in range(3):
        retention.thin(history, LIMITS)
    assert history.execute("PRAGMA page_count").fetchone()[0] < pages / 2
    assert history.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_the_writer_thins_and_tells_what_was_never_sent(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.storage.storage.THIN_EVERY_TICKS", 2)
    monkeypatch.setattr(retention, "CLOCK_TICKS", 1)
    storage = Storage(History.at(path, downsample_after_days=1.0), HandClock())
    storage.open()
    storage.write(at(1, 0.0))
    assert storage.wait_written(1, 20.0)
    storage.write(at(2, 2 * DAY_S))
    assert storage.close(20.0)
    assert [event.key for event in storage.events_pending()] == ["outbox.dropped"]
    with closing(Outbox(path, "g")) as outbox:
        assert outbox.depth() == 1


def test_skill_goes_with_the_windows_after_the_retention(history: sqlite3.Connection) -> None:
    row = ForecastSkill("arx", "v1", 5, 100, 0.1, 0.9, None, None, None)
    add(history, at(1, 0.0, skill=(row,)), at(2, 3600.0, skill=(row,)), *recent(3, 10 * DAY_S + 1.0))
    thin_all(history)
    kept = history.execute("SELECT hour_utc - ? FROM skill", (START_UTC,)).fetchall()
    assert kept == [(3600.0,)]
