"""edge/app/rest_offset.py: what the air's sensor reads beside the room's before anything warms the box."""

import numpy as np
import pytest

from edge.app.rest_offset import rest_offset_k, with_rest_offset
from edge.formats.run_file import RecordedRun
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value


def run(offset_k: float, idle_rows: int = 10, **changed: np.ndarray) -> RecordedRun:
    rows = np.arange(40)
    warmed = np.maximum(rows - idle_rows, 0) * 0.2
    columns = {
        "time_s": 10.0 * rows,
        "temp_air_c": 20.0 + offset_k + warmed,
        "temp_ambient_c": np.full(40, 20.0),
        "heater_duty": np.where(rows >= idle_rows, 1.0, 0.0),
        "fan_on": np.zeros(40),
    }
    return RecordedRun({**columns, **changed}, {})


def test_a_run_that_begins_at_rest_tells_its_sensors_offset() -> None:
    assert rest_offset_k(run(0.8)) == pytest.approx(0.8)
    bias = with_rest_offset(TwinFile(), run(0.8)).effects["sensor_bias"]["bias"]
    assert bias.value == pytest.approx(0.8)
    assert bias.value * (bias.rel_sd or 0.0) == pytest.approx(0.2)


def test_no_offset_at_all_has_its_spread_too() -> None:
    bias = with_rest_offset(TwinFile(), run(0.0)).effects["sensor_bias"]["bias"]
    assert abs(bias.value) * (bias.rel_sd or 0.0) == pytest.approx(0.2)


@pytest.mark.parametrize(
    "begun",
    [
        run(0.8, idle_rows=3),  # too short to tell
        run(2.5),  # the box is still warm from before
        run(0.5, temp_air_c=np.linspace(21.0, 18.0, 40)),  # it cools
        run(0.5, temp_ambient_c=np.linspace(18.0, 21.0, 40)),  # the room is being heated
        run(0.5, temp_ambient_c=np.full(40, np.nan)),
        run(0.5, fan_on=np.ones(40)),
    ],
)
def test_a_run_that_begins_otherwise_tells_none(begun: RecordedRun) -> None:
    assert with_rest_offset(TwinFile(), begun).effects == TwinFile().effects


def test_a_bias_that_is_known_stays() -> None:
    file = TwinFile(effects={"sensor_bias": {"bias": Value(0.3)}})
    assert with_rest_offset(file, run(0.8)) is file
