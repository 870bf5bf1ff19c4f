from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.models.arx import Arx
from edge.models.fit_arx import fit_arx, free_run_rmse, provenance

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
