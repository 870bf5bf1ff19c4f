from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.twin.fit import fit_twin
from edge.twin.model import BoxTwin
from edge.twin.run_batch import batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

LOSS_AND_CAPACITY = {"wall_loss": {"UA": 4.2}, "extra_capacity": {"kC": 20.0}}
WITH_WALL = {
    "wall_mass": {"C_w": 9000.0, "G_in": 9.0, "G_out": 8.0},
    "heater_lag": {"tau_h": 400.0},
    "extra_capacity": {"kC": 6.0},
}
UA, KC = ("effects", "wall_loss", "UA"), ("effects", "extra_capacity", "kC")


def made_run(effects, seed, rows=150, noise_k=0.05, ambient=True, hidden_k=0.0, **facts):
    """A run of a twin with these effects: duties and fan that last some minutes, noise on the sensor."""
    rng, twin = np.random.default_rng(seed), BoxTwin(effects=effects)
    duty = np.repeat(rng.choice([0.0, 0.0, 0.3, 0.6], rows // 10 + 1), 10)[:rows]
    fan = np.repeat((rng.uniform(size=rows // 5 + 1) < 0.2).astype(float), 5)[:rows]
    room = 21.0 + (0.3 * np.sin(np.arange(rows) / 20.0 + seed) if ambient else 0.0)
    start = at_rest(twin, 22.0, 21.0)
    start[1:] += hidden_k
    temps = twin.rollout(start, duty[None, :-1], fan[None, :-1], np.broadcast_to(room, rows)[:-1])[0]
    columns = {
        "time_s": 60.0 * np.arange(rows),
        "temp_air_c": np.append(22.0, temps) + rng.normal(0.0, noise_k, rows),
        "heater_duty": duty,
        "fan_on": fan,
    }
    if ambient:
        columns["temp_ambient_c"] = room
    return RecordedRun(columns, {"role": "train", **facts}, Path(f"run_{seed}.csv"))


def to_fit(effects, factor=0.5):
    """A file in which every parameter is to be fitted, from another start."""
    return TwinFile(
        effects={
            name: {key: Value(factor * value, fit=True) for key, value in own.items()}
            for name, own in effects.items()
        }
    )


@pytest.fixture(scope="module")
def runs():
    return [made_run(LOSS_AND_CAPACITY, seed) for seed in (1, 2, 3)]


def test_loss_and_capacity_come_back_inside_their_intervals(runs):
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), runs)
    assert fit.estimates[UA].low < 4.2 < fit.estimates[UA].high
    assert fit.estimates[KC].low < 20.0 < fit.estimates[KC].high
    assert fit.estimates[UA].value == pytest.approx(4.2, rel=0.01)
    assert fit.rmse_k == pytest.approx(0.05, rel=0.1)  # the noise that was put in
    assert (fit.rows, fit.ambient_c) == (3 * 149, None)
    value = fit.file.effects["wall_loss"]["UA"]
    assert (value.value, value.low, value.high) == (
        fit.estimates[UA].value,
        fit.estimates[UA].low,
        fit.estimates[UA].high,
    )
    assert fit.file.to_fit() == []


def test_without_noise_hidden_states_and_all_their_parameters_are_found():
    starts = [made_run(WITH_WALL, seed, noise_k=0.0, hidden_k=1.5 * seed) for seed in (1, 2)]
    fit = fit_twin(to_fit(WITH_WALL, 0.7), starts)
    for place, estimate in fit.estimates.items():
        assert estimate.value == pytest.approx(WITH_WALL[place[1]][place[2]], rel=0.02), place


def test_a_fan_that_spins_up_is_found_though_its_speed_is_rounded():
    effects = {"wall_loss": {"UA": 4.2}, "extra_capacity": {"kC": 4.0}, "fan_spinup": {"tau_f": 30.0}}
    fit = fit_twin(to_fit(effects, 0.6), [made_run(effects, seed) for seed in (1, 2)])
    found = fit.estimates["effects", "fan_spinup", "tau_f"]
    assert found.low < 30.0 < found.high
    assert found.high - found.low < 5.0


def test_missing_temperatures_change_little(runs):
    holes = [
        RecordedRun({**run.columns, "temp_air_c": run.columns["temp_air_c"].copy()}, run.facts)
        for run in runs
    ]
    for run in holes:
        run.columns["temp_air_c"][[0, 1, 40, 41, 42, -1]] = np.nan
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), holes)
    assert fit.rows == 3 * (149 - 6)
    assert fit.estimates[UA].value == pytest.approx(4.2, rel=0.01)


def test_runs_of_different_lengths_go_together(runs):
    short = made_run(LOSS_AND_CAPACITY, seed=4, rows=60)
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), [*runs, short])
    assert fit.rows == 3 * 149 + 59
    assert fit.estimates[UA].value == pytest.approx(4.2, rel=0.01)


def test_a_room_that_nobody_measured_is_a_constant():
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), [made_run(LOSS_AND_CAPACITY, s, ambient=False) for s in (1, 2)])
    assert fit.ambient_c is not None and fit.ambient_c.low < 21.0 < fit.ambient_c.high
    assert fit.estimates[UA].value == pytest.approx(4.2, rel=0.02)


def test_a_prior_holds_what_the_data_do_not_tell(runs):
    # eta, UA, kC and the fan have one common scale: only the prior on eta tells it
    file = TwinFile(
        effects={
            "wall_loss": {"UA": Value(3.0, fit=True)},
            "extra_capacity": {"kC": Value(10.0, fit=True)},
            "heater_efficiency": {"eta": Value(1.0, rel_sd=0.02)},
            "fan_effectiveness": {"eps_f": Value(1.0, fit=True)},
        }
    )
    fit = fit_twin(file, runs)
    eta = fit.estimates["effects", "heater_efficiency", "eta"]
    assert eta.value == pytest.approx(1.0, abs=1e-3)
    assert eta.sd == pytest.approx(0.02, rel=0.05)
    assert fit.estimates[UA].sd == pytest.approx(0.02 * 4.2, rel=0.3)


def test_a_geometry_value_can_be_fitted_too():
    power = TwinFile().with_values({("geometry", "heater_max_w"): Value(50.0, fit=True)})
    fit = fit_twin(power, [made_run({}, 1)])
    assert fit.estimates["geometry", "heater_max_w"].value == pytest.approx(100.0, rel=0.01)


def test_a_parameter_at_its_bound_says_so(runs):
    bare = [made_run({"wall_loss": {"UA": 4.0}}, seed) for seed in (1, 2)]
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), bare)
    assert fit.estimates[KC].at_bound  # nothing but air: kC = 1
    assert fit.estimates[KC].low == 1.0


def test_rows_that_validate_are_not_fitted_on(runs):
    columns = {name: values.copy() for name, values in runs[0].columns.items()}
    columns["temp_air_c"][100:] = 99.0
    half = RecordedRun(columns, {"role": "train", "validate_from_s": "6000"})
    fit = fit_twin(to_fit(LOSS_AND_CAPACITY), [half])
    assert fit.rows == 99
    assert fit.estimates[UA].value == pytest.approx(4.2, rel=0.02)


def test_a_run_at_another_period_is_resampled(runs):
    fine = {name: np.repeat(values, 2) for name, values in runs[0].columns.items()}
    fine["time_s"] = 30.0 * np.arange(300)
    data, plain = batch_runs([RecordedRun(fine)], 60.0), batch_runs([runs[0]], 60.0)
    np.testing.assert_array_equal(data.duty, plain.duty)
    np.testing.assert_array_equal(data.temp, plain.temp)


def without(run, *names, **facts):
    return RecordedRun(
        {k: v for k, v in run.columns.items() if k not in names}, {**run.facts, **facts}, run.path
    )


def unknown_temps(run):
    return RecordedRun(
        {**run.columns, "temp_air_c": np.append(20.0, np.full(149, np.nan))}, run.facts, run.path
    )


REFUSALS = {
    "a test run": (lambda r: [r[0], without(r[1], role="test")], r"run_2\.csv: role: a test run is never"),
    "no run": (lambda r: [], r"fit: needs at least one run"),
    "one temperature": (lambda r: [unknown_temps(r[0])], r"run_1\.csv: temp_air_c: fewer than two"),
    "a room in some": (
        lambda r: [r[0], without(r[1], "temp_ambient_c")],
        r"temp_ambient_c: some runs have it and others not",
    ),
    "validation at no time": (
        lambda r: [without(r[0], validate_from_s="noon")],
        r"run_1\.csv: validate_from_s: 'noon' is no number",
    ),
}


@pytest.mark.parametrize(("choose", "message"), REFUSALS.values(), ids=REFUSALS)
def test_runs_that_can_not_be_fitted_on_are_refused(runs, choose, message):
    with pytest.raises(DataError, match=message):
        fit_twin(to_fit(LOSS_AND_CAPACITY), choose(runs))


def test_a_file_with_nothing_to_fit_is_refused(runs):
    with pytest.raises(DataError, match=r"^fit: no value of the twin is to be fitted"):
        fit_twin(TwinFile(effects={"wall_loss": {"UA": Value(5.0)}}), runs)


def test_a_parameter_of_an_effect_that_is_replaced_is_refused(runs):
    with pytest.raises(DataError, match=r"^effects\.wall_loss\.UA: does nothing beside the effect"):
        fit_twin(to_fit({**LOSS_AND_CAPACITY, **WITH_WALL}), runs)


def test_a_parameter_that_these_runs_do_not_tell_is_refused(runs):
    still = [without(run, "fan_on") for run in runs]
    with pytest.raises(DataError, match=r"^effects\.fan_effectiveness\.eps_f: these runs do not tell it"):
        fit_twin(to_fit({"wall_loss": {"UA": 4.0}, "fan_effectiveness": {"eps_f": 0.8}}), still)
