import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.errors import DataError
from edge.models.arx import Arx
from edge.models.arx_file import DEFAULT_PATH, read_arx, write_arx

MODEL = Arx(
    temp=np.array([0.8, 0.1]),
    heater=np.array([2.0, 1.0, 0.5]),
    fan=np.array([-1.0, -0.5, -0.25]),
    ambient=0.1,
    intercept=0.5,
    step_s=60.0,
    validity={"temp_air_c": (20.0, 37.0)},
)


def history(temps, heater, fan):
    return {
        "temp_air": np.array(temps, dtype=float),
        "heater_duty": np.array(heater, dtype=float),
        "fan_on": np.array(fan, dtype=float),
    }


PAST = history([20.0, 21.0, 22.0], [0.2, 0.4, np.nan], [1.0, 0.0, np.nan])


def test_two_steps_are_the_equation_by_hand():
    controls = np.array([[[1.0, 0.0], [0.0, 1.0]]])
    ahead = {"temp_ambient": np.array([21.0, 20.0])}
    first = 0.8 * 22 + 0.1 * 21 + (2.0 * 1.0 + 1.0 * 0.4 + 0.5 * 0.2) + (-0.25 * 1.0) + 0.1 * 21 + 0.5
    second = 0.8 * first + 0.1 * 22 + (1.0 * 1.0 + 0.5 * 0.4) + (-1.0 * 1.0) + 0.1 * 20 + 0.5
    np.testing.assert_allclose(MODEL.rollout(PAST, controls, ahead)[0], [first, second])


def test_the_offset_is_added_at_every_step():
    controls = np.zeros((1, 2, 2))
    ambient = {"temp_ambient": np.full(2, 20.0)}
    plain = MODEL.rollout(PAST, controls, ambient)[0]
    moved = MODEL.rollout(PAST, controls, {**ambient, "offset": np.full(2, 0.1)})[0]
    np.testing.assert_allclose(moved - plain, [0.1, 0.1 + 0.8 * 0.1])


def test_a_batch_is_its_rows():
    rng = np.random.default_rng(0)
    controls = rng.uniform(size=(5, 12, 2))
    ahead = {"temp_ambient": rng.uniform(18, 22, size=12)}
    together = MODEL.rollout(PAST, controls, ahead)
    for row in range(5):
        np.testing.assert_allclose(together[row], MODEL.rollout(PAST, controls[row : row + 1], ahead)[0])


@given(st.integers(1, 10), st.integers(0, 2**32 - 1))
def test_inputs_enter_linearly(horizon, seed):
    rng = np.random.default_rng(seed)
    one, two = rng.uniform(size=(2, 1, horizon, 2))
    ahead = {"temp_ambient": np.full(horizon, 21.0)}
    nothing = MODEL.rollout(PAST, np.zeros((1, horizon, 2)), ahead)
    both = MODEL.rollout(PAST, one + two, ahead)
    apart = MODEL.rollout(PAST, one, ahead) + MODEL.rollout(PAST, two, ahead)
    np.testing.assert_allclose(both - nothing, apart - 2 * nothing, atol=1e-9)


@pytest.mark.parametrize(
    "other",
    [
        history([20.0, 21.0, 22.0], [0.2, 0.4, 9.0], [1.0, 0.0, 9.0]),
        history([5.0, 20.0, 21.0, 22.0], [1.0, 0.2, 0.4, np.nan], [1.0, 1.0, 0.0, np.nan]),
    ],
    ids=["inputs of the last row", "an older row"],
)
def test_what_is_not_among_the_lags_is_not_read(other):
    ahead = {"temp_ambient": np.full(3, 21.0)}
    controls = np.full((1, 3, 2), 0.5)
    np.testing.assert_array_equal(MODEL.rollout(PAST, controls, ahead), MODEL.rollout(other, controls, ahead))


def test_a_history_one_row_too_short_is_refused():
    with pytest.raises(DataError, match="2 rows, the ARX model needs 3"):
        MODEL.rollout(
            history([21.0, 22.0], [0.4, np.nan], [0.0, np.nan]),
            np.zeros((1, 1, 2)),
            {"temp_ambient": np.full(1, 21.0)},
        )


def test_a_model_without_ambient_needs_none():
    model = Arx(np.array([0.9]), np.array([1.0]), np.array([-1.0]), 0.0, 2.0, 60.0)
    temps = model.rollout(history([20.0], [np.nan], [np.nan]), np.zeros((1, 1, 2)), {})
    assert temps.tolist() == [[20.0]]


def test_a_dead_sensor_in_the_history_is_seen_in_the_forecast():
    broken = history([20.0, np.nan, 22.0], [0.2, 0.4, np.nan], [1.0, 0.0, np.nan])
    ahead = {"temp_ambient": np.full(3, 21.0)}
    assert np.isnan(MODEL.rollout(broken, np.zeros((1, 3, 2)), ahead)).all()


def test_a_written_model_is_read_back_exactly(tmp_path):
    path = tmp_path / "arx.json"
    write_arx(MODEL, path, {"command": "fit"})
    model = read_arx(path)
    for name in ("temp", "heater", "fan"):
        np.testing.assert_array_equal(getattr(model, name), getattr(MODEL, name))
    assert (model.ambient, model.intercept, model.step_s) == (0.1, 0.5, 60.0)
    assert model.validity == MODEL.validity
    assert len(model.version) == 12
    path.write_text(path.read_text().replace("0.5", "0.6"))
    assert read_arx(path).version != model.version


def test_the_packaged_model_is_stable_and_heats_and_cools():
    model = read_arx(DEFAULT_PATH)
    rows = model.rows_needed
    past = in_a_room(history([30.0] * rows, [0.0] * rows, [0.0] * rows), 21.0)
    controls = np.zeros((3, 300, 2))
    controls[1, :, 0] = 1.0
    controls[2, :, 1] = 1.0
    temps = model.rollout(past, controls, {"temp_ambient": np.full(300, 21.0)})
    assert (temps[1, 1:] > temps[0, 1:]).all()
    assert (temps[2, :30] < temps[0, :30]).all()  # later both are at the room's temperature
    assert (abs(temps[:, -1] - temps[:, -2]) < 0.01).all()


EXCESS = replace(MODEL, fan=np.array([-0.1, -0.05, -0.02]), fan_input="excess")


def in_a_room(columns, temp_ambient):
    return {**columns, "temp_ambient": np.full(len(columns["temp_air"]), temp_ambient)}


def test_a_fan_by_the_excess_is_the_equation_by_hand():
    controls = np.array([[[1.0, 1.0], [0.0, 1.0]]])
    ahead = {"temp_ambient": np.array([21.0, 20.0])}
    past_fan = 1.0 * (20.0 - 18.0)  # of the oldest row, in a room of 18 °C
    first = 0.8 * 22 + 0.1 * 21 + (2.0 * 1.0 + 1.0 * 0.4 + 0.5 * 0.2) + 0.1 * 21 + 0.5
    first += -0.1 * (22 - 21) - 0.02 * past_fan
    second = 0.8 * first + 0.1 * 22 + (1.0 * 1.0 + 0.5 * 0.4) + 0.1 * 20 + 0.5
    second += -0.1 * (first - 20) - 0.05 * (22 - 21)
    np.testing.assert_allclose(EXCESS.rollout(in_a_room(PAST, 18.0), controls, ahead)[0], [first, second])


@given(st.floats(15.0, 40.0), st.integers(1, 20))
def test_a_fan_by_the_excess_does_nothing_at_room_temperature(room, horizon):
    still = replace(EXCESS, temp=np.array([1.0]), heater=np.zeros(3), ambient=0.0, intercept=0.0)
    past = in_a_room(history([room] * 3, [0.0] * 3, [1.0] * 3), room)
    controls = np.ones((1, horizon, 2))
    temps = still.rollout(past, controls, {"temp_ambient": np.full(horizon, room)})
    np.testing.assert_allclose(temps, room)


@pytest.mark.parametrize("temp", [23.0, 27.0, 35.0])
def test_the_duty_to_hold_holds(temp):
    model = read_arx(DEFAULT_PATH)
    duty = model.duty_to_hold(temp, 21.0, offset=0.01)
    rows = model.rows_needed
    past = in_a_room(history([temp] * rows, [duty] * rows, [0.0] * rows), 21.0)
    controls = np.tile([duty, 0.0], (1, 60, 1))
    ahead = {"temp_ambient": np.full(60, 21.0), "offset": np.full(60, 0.01)}
    assert 0.0 < duty < 1.0
    np.testing.assert_allclose(model.rollout(past, controls, ahead), temp, atol=1e-6)


@pytest.mark.parametrize(("temp", "duty"), [(10.0, 0.0), (80.0, 1.0)])
def test_the_duty_to_hold_is_a_duty(temp, duty):
    assert read_arx(DEFAULT_PATH).duty_to_hold(temp, 21.0, 0.0) == duty
    assert replace(MODEL, heater=np.zeros(3)).duty_to_hold(temp, 21.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("format", 1, "format: 1 is not 2"),
        ("fan_input", "off", "fan_input: 'off' is none of on, excess"),
        ("temp_air", [], "temp_air: must hold at least 1"),
        ("heater_duty", [1.0], "fan_on: 3 coefficients, heater_duty has 1"),
        ("step_s", 0.0, "step_s: 0 is not above 0"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(tmp_path, key, value, says):
    path = tmp_path / "arx.json"
    write_arx(MODEL, path, {})
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(DataError, match=f"{path}: {re.escape(says)}"):
        read_arx(path)


@pytest.mark.parametrize("model", [MODEL, EXCESS])
def test_the_responses_are_what_one_step_of_each_input_adds(model):
    controls = np.zeros((3, 9, 2))
    controls[1, 0, 0] = controls[2, 0, 1] = 1.0
    past = in_a_room(history([23.0] * 3, [0.0] * 3, [0.0] * 3), 21.0)
    free, heated, fanned = model.rollout(past, controls, {"temp_ambient": np.full(9, 21.0)})
    heater, fan = model.responses(9)
    np.testing.assert_allclose(heated - free, heater, atol=1e-12)
    np.testing.assert_allclose(fanned - free, fan * (2.0 if model is EXCESS else 1.0), atol=1e-12)
