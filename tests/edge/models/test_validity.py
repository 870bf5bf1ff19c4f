"""The box of the training data: what is inside, on its edge, and what rests on something outside."""

import numpy as np
import pytest

from edge.core.predictor import Floats
from edge.models.validity import box_of, outside_steps

BOX = {
    "temp_air_c": (20.0, 30.0),
    "heater_duty": (0.0, 0.5),
    "fan_on": (0.0, 1.0),
    "temp_ambient_c": (18.0, 24.0),
}


def outside(temps: list[float], duty: float = 0.25, room: float = 20.0, now: float = 25.0) -> list[bool]:
    """Flags of one sequence of two steps; its inputs are the same at both."""
    controls = np.array([[[duty, 1.0]] * 2])
    ahead = {"temp_ambient": np.array([room, room, np.nan])}  # longer than the rollout
    past = {"temp_air": np.array([99.0, now])}
    flags: list[bool] = outside_steps(BOX, past, controls, ahead, np.array([temps]))[0].tolist()
    return flags


def test_inside_and_on_the_edge_nothing_is_flagged() -> None:
    assert outside([25.0, 25.0]) == [False, False]
    assert outside([20.0, 30.0], duty=0.5, room=24.0, now=30.0) == [False, False]
    assert outside([25.0, 25.0], duty=0.5 + 1e-9) == [False, False]  # rounding is no extrapolation


@pytest.mark.parametrize("value", [19.99, 30.01, np.nan, np.inf, -np.inf])
def test_a_temperature_outside_is_flagged_from_its_step_on(value: float) -> None:
    assert outside([25.0, value]) == [False, True]
    assert outside([value, 25.0]) == [True, True]  # the second step was predicted from the first
    assert outside([25.0, 25.0], now=value) == [True, True]


@pytest.mark.parametrize("duty", [-0.01, 0.51, np.nan])
def test_an_input_outside_is_flagged(duty: float) -> None:
    assert outside([25.0, 25.0], duty=duty) == [True, True]


@pytest.mark.parametrize("room", [17.99, 24.01, np.nan])
def test_a_room_outside_is_flagged(room: float) -> None:
    assert outside([25.0, 25.0], room=room) == [True, True]


def test_each_sequence_is_flagged_by_itself() -> None:
    controls = np.array([[[0.5, 0.0]], [[0.6, 0.0]], [[0.5, 1.0]]])
    flags = outside_steps(
        {"heater_duty": (0.0, 0.5)}, {"temp_air": np.array([0.0])}, controls, {}, np.zeros((3, 1))
    )
    assert flags.tolist() == [[False], [True], [False]]


def test_the_box_of_runs_spans_what_was_measured() -> None:
    def run(*temps: float) -> dict[str, Floats]:
        return {"temp_air_c": np.array(temps), "light": np.ones(len(temps))}

    assert box_of([run(21.0, np.nan, 25.0), run(19.5)], ["temp_air_c"]) == {"temp_air_c": (19.5, 25.0)}
