"""The bench of a box's own data: which rows a span has, and what a free run over a later day comes to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.boxes.own_data import OwnData, free_run_k
from edge.formats.run_file import RecordedRun
from edge.twin.rollout import Commands
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import at_rest

TWIN = Path("training/results/paper_case/interpolation/twin.yaml").resolve()
ROOM_C = 21.0


def rows(count: int, step_s: float) -> RecordedRun:
    time_s = step_s * np.arange(count)
    return RecordedRun(
        {"time_s": time_s, "temp_air_c": np.full(count, 25.0)}, {"start_utc": "2026-01-01T00:00:00"}
    )


@pytest.mark.parametrize(("hours", "minutes"), [(3.0, 60), (12.0, 600), (168.0, 9960)])
def test_a_span_has_the_tests_and_the_rest_of_its_hours(hours: float, minutes: int) -> None:
    data = OwnData(rows(720, 10.0), rows(8 * 1440, 60.0))
    tests, days = data.until(hours)
    assert (len(tests), len(days)) == (720, minutes)
    day = data.later_day()
    assert len(day) == 1440 and day.columns["time_s"][0] == 0.0
    # No fit sees a row of the day that judges.
    assert len(data.until(168.0)[1]) <= len(data.days) - len(day)


def test_a_twin_is_off_by_nothing_over_a_day_of_its_own_and_by_much_over_another_boxes() -> None:
    file = replace(read_twin_file(TWIN), sample_s=60.0)
    twin, count = file.twin(), 1440
    duty = np.where(np.arange(count) // 60 % 2, 0.6, 0.1)[None]
    fan = np.zeros((1, count))
    rest = at_rest(twin, twin.signals.room(np.array(ROOM_C)), ROOM_C)
    before = Commands(0.0 * duty[:, :5], fan[:, :5])
    given = {name: np.zeros(count) for name in twin.needs}
    air = twin.rollout(rest, duty, fan, ROOM_C, conditions=given, before=before)[0]
    columns = {
        "time_s": 60.0 * np.arange(count),
        "temp_air_c": np.append(ROOM_C, air[:-1]),
        "temp_ambient_c": np.full(count, ROOM_C),
        "heater_duty": duty[0],
        "fan_on": fan[0],
    }
    day = RecordedRun(columns, {})
    own_k = free_run_k(file, day)
    other = columns["temp_air_c"] + 0.3 * (air - ROOM_C)
    other_k = free_run_k(file, replace(day, columns={**columns, "temp_air_c": other}))
    assert own_k < 0.1 and other_k > 1.0
