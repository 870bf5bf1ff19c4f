"""The ARX: its rollout, its file, and its fit."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.models.arx import Arx
from edge.models.arx_file import DEFAULT_PATH, read_arx, write_arx
from edge.models.fit_arx import fit_arx, free_run_rmse, provenance

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


# the fit


TRUE = Arx(
    temp=np.array([0.9, -0.1]),
    heater=np.array([2.0, 0.5]),
    fan=np.array([-1.0, -0.2]),
    ambient=0.15,
    intercept=1.0,
    step_s=60.0,
)
ORDERS = ((1, 1), (2, 2), (3, 2))


def recorded(seed: int, rows: int = 200, model: Arx = TRUE, noise_k: float = 0.0) -> RecordedRun:
    """A run that the model made, with steps in every input."""
    rng = np.random.default_rng(seed)
    blocks = rows // 5 + 1
    heater = np.repeat(rng.integers(0, 21, blocks) / 20, 5)[:rows]
    fan = np.repeat(rng.integers(0, 2, blocks), 5)[:rows].astype(float)
    ambient = 20.0 + np.cumsum(rng.normal(scale=0.1, size=rows))
    begin = np.full(2, ambient[0])
    history = {
        "temp_air": begin, "temp_ambient": begin, "heater_duty": np.zeros(2), "fan_on": np.zeros(2)
    }  # fmt: skip
    controls = np.stack([heater, fan], axis=-1)[None, :-1]
    temps = model.rollout(history, controls, {"temp_ambient": ambient})[0]
    temp = np.append(ambient[0], temps) + noise_k * rng.normal(size=rows)
    return RecordedRun(
        {
            "time_s": 60.0 * np.arange(rows),
            "temp_air_c": temp,
            "temp_ambient_c": ambient,
            "heater_duty": heater,
            "fan_on": fan,
        }
    )


def without(run: RecordedRun, *keys: str) -> RecordedRun:
    return RecordedRun({key: values for key, values in run.columns.items() if key not in keys})


def changed(run: RecordedRun, key: str, values: np.ndarray) -> RecordedRun:
    return RecordedRun({**run.columns, key: values})


def assert_is_the_true_one(model: Arx) -> None:
    np.testing.assert_allclose(model.temp, TRUE.temp, atol=1e-6)
    np.testing.assert_allclose(model.heater, TRUE.heater, atol=1e-6)
    np.testing.assert_allclose(model.fan, TRUE.fan, atol=1e-6)
    assert model.ambient == pytest.approx(0.15, abs=1e-6)
    assert model.intercept == pytest.approx(1.0, abs=1e-4)


def test_the_model_that_made_the_runs_is_found_with_its_orders():
    fit = fit_arx([recorded(1), recorded(2)], [recorded(3)], 60.0, ORDERS)
    assert_is_the_true_one(fit.model)
    assert fit.free_run_rmse_k < 1e-6
    assert [(score.p, score.q) for score in fit.scores] == list(ORDERS)


def test_runs_are_never_joined_at_their_borders():
    first_half = RecordedRun({key: values[:100] for key, values in recorded(2).columns.items()})
    other = RecordedRun({key: values[100:] for key, values in recorded(5).columns.items()})
    assert_is_the_true_one(fit_arx([first_half, other], [recorded(3)], 60.0, [(2, 2)]).model)


def test_a_gap_costs_only_the_rows_that_touch_it():
    run = recorded(1)
    temp = run.columns["temp_air_c"].copy()
    temp[50:53] = np.nan
    fit = fit_arx([changed(run, "temp_air_c", temp)], [recorded(3)], 60.0, [(2, 2)])
    assert_is_the_true_one(fit.model)
    assert fit.rows == 198 - 5  # rows whose lags or target lie in the gap of three: t = 49..53


def test_noise_chooses_by_forecasts_and_not_by_the_fit():
    runs = [recorded(seed, noise_k=0.1) for seed in range(6)]
    fit = fit_arx(runs[:4], runs[4:], 60.0, ((1, 1), (2, 2), (6, 4)))
    assert fit.free_run_rmse_k == pytest.approx(min(score.rmse_k for score in fit.scores), rel=0.011)


def test_a_run_recorded_faster_is_resampled():
    slow = recorded(1)
    fast = {
        "time_s": 20.0 * np.arange(3 * 199 + 1),
        **{key: np.repeat(slow.columns[key], 3)[:-2] for key in ("heater_duty", "fan_on")},
        **{
            key: np.interp(np.arange(3 * 199 + 1) / 3, np.arange(200), slow.columns[key])
            for key in ("temp_air_c", "temp_ambient_c")
        },
    }
    assert_is_the_true_one(fit_arx([RecordedRun(fast)], [recorded(3)], 60.0, [(2, 2)]).model)


def test_a_fan_by_the_excess_is_found_again():
    true = replace(TRUE, fan=np.array([-0.1, -0.03]), fan_input="excess")
    one, two, three = (recorded(seed, model=true) for seed in (1, 2, 3))
    fit = fit_arx([one, two], [three], 60.0, [(2, 2)], "excess")
    np.testing.assert_allclose(fit.model.fan, true.fan, atol=1e-6)
    assert fit.model.fan_input == "excess"
    assert fit.free_run_rmse_k < 1e-6


def test_the_excess_needs_the_room_temperature():
    with pytest.raises(DataError, match="needs the room temperature"):
        fit_arx([recorded(1)], [recorded(3)], 60.0, [(2, 2)], "excess", with_ambient=False)


def test_an_input_can_be_left_out():
    still = changed(recorded(1), "fan_on", np.ones(200))
    fit = fit_arx([without(still, "fan_on", "temp_ambient_c")], [recorded(3)], 60.0, [(2, 2)], None, False)
    assert fit.model.fan.tolist() == [0.0, 0.0]
    assert fit.model.ambient == 0.0
    assert set(fit.model.validity) == {"temp_air_c", "heater_duty"}


@pytest.mark.parametrize(
    ("run", "says"),
    [
        (changed(recorded(1), "fan_on", np.ones(200)), "fan_on: 1 in every row"),
        (changed(recorded(1), "heater_duty", np.zeros(200)), "heater_duty: 0 in every row"),
        (changed(recorded(1), "temp_ambient_c", np.full(200, 21.0)), "temp_ambient_c: 21 in every row"),
        (changed(recorded(1), "fan_on", np.full(200, np.nan)), "fan_on: no value"),
        (without(recorded(1), "fan_on"), "fan_on: the column is missing"),
        (without(recorded(1), "temp_air_c"), "temp_air_c: the column is missing"),
        (changed(recorded(1), "time_s", 120.0 * np.arange(200)), "period of 120 s"),
        (RecordedRun({key: values[:12] for key, values in recorded(1).columns.items()}), "too few rows"),
        (RecordedRun({key: values[:1] for key, values in recorded(1).columns.items()}), "period of 0 s"),
    ],
)
def test_what_cannot_be_fitted_is_refused_with_its_place(run, says):
    with pytest.raises(DataError, match=says):
        fit_arx([run], [recorded(3)], 60.0, [(2, 2)])


@pytest.mark.parametrize("role", ["test", " Test ", "TEST"])
def test_nothing_is_fitted_or_chosen_on_a_test_run(role):
    tested = replace(recorded(2), facts={"role": role}, path=Path("scenario_1.csv"))
    for training, validation in (([recorded(1), tested], [recorded(3)]), ([recorded(1)], [tested])):
        with pytest.raises(DataError, match=r"scenario_1\.csv: role: a test run is never fitted on"):
            fit_arx(training, validation, 60.0, [(2, 2)])


@pytest.mark.parametrize("facts", [{}, {"role": "train"}, {"role": "validate"}, {"notes": "test"}])
def test_any_other_run_may_be_fitted_on(facts):
    run = replace(recorded(1), facts=facts)
    assert_is_the_true_one(fit_arx([run, recorded(2)], [recorded(3)], 60.0, [(2, 2)]).model)


def test_no_runs_are_refused():
    with pytest.raises(DataError, match="at least one"):
        fit_arx([], [recorded(3)], 60.0)


def test_the_true_model_has_no_free_run_error_and_a_dead_sensor_tells_nothing():
    run = recorded(4)
    assert free_run_rmse(TRUE, [run.columns]) < 1e-9
    dead = {**run.columns, "temp_air_c": np.full(200, np.nan)}
    assert np.isnan(free_run_rmse(TRUE, [dead]))


def test_provenance_names_the_data_by_hash(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time_s\n")
    run = RecordedRun(recorded(1).columns, path=path)
    fit = fit_arx([run], [recorded(3)], 60.0, [(2, 2)])
    facts = provenance(fit, [run], [recorded(3)], "greenhouse fit-arx run.csv")
    assert len(facts["training_sha256"][str(path)]) == 64
    assert facts["command"] == "greenhouse fit-arx run.csv"
    assert facts["rows"] == fit.rows
