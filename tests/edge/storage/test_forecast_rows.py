"""Forecasts and skill in the history."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from history_records import START_UTC, add, eventful_tick, tick

from edge.core.messages import Forecast, ForecastSkill, TickRecord
from edge.storage.file import PAGE_BYTES, connect
from edge.storage.tick_rows import read_ticks

HOUR_S = 3600.0


@pytest.fixture
def history(tmp_path: Path) -> Iterator[sqlite3.Connection]:
    with closing(connect(tmp_path / "history.db", 5.0)) as connection:
        yield connection


def skill(mae_k: float, horizon_min: int = 5, **values: object) -> ForecastSkill:
    given = {"against_persistence": 0.9, "against_pbm": None, "half_width_k": 0.5, "covered": 0.91, **values}
    return ForecastSkill("arx", "v1", horizon_min, 100, mae_k, **given)


def test_forecasts_read_back_to_a_hundredth(history: sqlite3.Connection) -> None:
    add(history, eventful_tick(1), tick(2, forecasts={}))
    back = read_ticks(history, [1, 2])
    assert back[1].forecasts == {
        "arx": Forecast(reason="not a number after step 1"),
        "ham": Forecast({1: 25.12}, outside=True),
        "pbm": Forecast({1: -1234.5}),
    }
    assert back[2].forecasts == {}


def test_the_view_has_a_row_per_predictor_and_horizon_with_its_interval(history: sqlite3.Connection) -> None:
    uncalibrated = Forecast({1: 20.0})
    add(history, tick(1, forecasts={"arx": Forecast({1: 25.0, 60: 27.0}, {60: 0.5}), "lstm": uncalibrated}))
    assert history.execute(
        "SELECT seq, predictor, horizon_min, temp_c, low_c, high_c, outside FROM v_forecasts ORDER BY 2, 3"
    ).fetchall() == [
        (1, "arx", 1, 25.0, None, None, None),
        (1, "arx", 60, 27.0, 26.5, 27.5, None),
        (1, "lstm", 1, 20.0, None, None, None),
    ]


def test_each_hour_keeps_the_skill_at_its_first_tick(history: sqlite3.Connection) -> None:
    add(
        history, tick(1, utc=START_UTC, skill=(skill(0.1),)), tick(2, utc=START_UTC + 60, skill=(skill(0.2),))
    )
    add(history, tick(3, utc=START_UTC + HOUR_S - 1, skill=(skill(0.3), skill(0.7, 60))))
    add(history, tick(4, utc=START_UTC + HOUR_S, skill=(skill(0.4),)), tick(5, utc=START_UTC + HOUR_S + 60))
    rows = history.execute("SELECT hour_utc, horizon_min, mae_k FROM v_skill ORDER BY 1, 2").fetchall()
    hour = int(START_UTC)  # the first second of 2026
    assert rows == [(hour, 5, 0.1), (hour, 60, 0.7), (hour + 3600, 5, 0.4)]


def test_what_is_not_known_of_a_skill_is_null(history: sqlite3.Connection) -> None:
    add(history, tick(1, skill=(skill(0.1, against_persistence=None, half_width_k=None, covered=None),)))
    assert history.execute(
        "SELECT version, scored, against_persistence, against_pbm, half_width_k, covered FROM skill"
    ).fetchall() == [("v1", 100, None, None, None, None)]


@pytest.mark.slow
def test_a_day_of_four_predictors_is_half_a_megabyte(history: sqlite3.Connection) -> None:
    horizons = (1, 5, 15, 30, 60)
    one = Forecast(dict.fromkeys(horizons, 25.123), dict.fromkeys(horizons, 0.123), outside=False)
    four = dict.fromkeys(("arx", "ham", "lstm", "pbm"), one)
    rows = tuple(skill(0.1234, minutes) for minutes in horizons)

    def grown(*records: TickRecord) -> int:
        add(history, *records)
        return int(history.execute("PRAGMA page_count").fetchone()[0]) * PAGE_BYTES

    start = grown()
    plain = grown(*(tick(seq, forecasts={}) for seq in range(1, 1441))) - start
    all_of_it = grown(*(tick(seq, forecasts=four, skill=rows) for seq in range(1441, 2881))) - plain - start
    assert 400_000 < all_of_it - plain < 600_000
