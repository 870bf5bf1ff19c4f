"""edge/twin/linearise.py: a twin as one linear step a row, many at once."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.twin.effects.library import EFFECTS, UNNAMED_EFFECTS
from edge.twin.linearise import EnsembleRun, linearise, responses
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest
from tests.support.simulated_runs import BOX, Effects, Floats

ROWS, RUNS = 90, 2
DAY0_UTC = 1e9
AIR_ALONE = {"wall_mass": {"C_w": 5000.0, "G_in": 10.0, "G_out": 8.0}}  # its own time constant is 10 s
ROUNDING_K = 1e-10
# Half of the half hour to which walls age: 1/96 of a day of ua_drift's 0.01/d on 4 W/K at 20 K is 8 mW, and
# 8 mW over 4 W/K is 2 mK.
AGEING_K = 2e-3


def recording() -> RunBatch:
    """Two runs, six days apart, in which every input moves; temperatures are put in later."""
    draw = np.random.default_rng(1)
    rows, column = np.arange(ROWS), np.ones((RUNS, 1))
    duty = np.repeat(draw.choice([0.0, 0.3, 0.6, 1.0], (RUNS, ROWS // 6)), 6, axis=1)
    fan = np.repeat((draw.random((RUNS, ROWS // 5)) < 0.3).astype(float), 5, axis=1)
    duty[:, :2] = fan[:, :2] = 0.0
    door = np.zeros((RUNS, ROWS))
    door[:, 30:33] = 1.0, 1.0, 0.5
    conditions = {
        "light": column * (rows // 20 % 2),
        "rel_humidity": column * (50.0 + 10.0 * np.sin(rows / 9.0)),
        "solar": column * (400.0 + 300.0 * np.cos(rows / 11.0)),
        "utc": DAY0_UTC + 60.0 * rows + 86400.0 * np.array([[0.0], [6.0]]),
        "door_open": door,
    }
    ambient = column * (21.0 + np.sin(rows / 20.0))
    return RunBatch(np.full((RUNS, ROWS + 1), 21.0), duty, fan, ambient, conditions)


def twin_with(name: str, box: Effects = BOX) -> BoxTwin:
    start = {item.name: item.start for item in EFFECTS[name].parameters}
    return BoxTwin(effects={**box, name: start}, day0_utc=DAY0_UTC)


def rolled(twin: BoxTwin, runs: RunBatch, start: Floats) -> Floats:
    return twin.rollout(start, runs.duty, runs.fan, runs.ambient, conditions=runs.conditions)


def rest(twin: BoxTwin, runs: RunBatch) -> Floats:
    return at_rest(twin, runs.ambient[:, 0], runs.ambient[:, 0])


def error_k(twin: BoxTwin, noise_k: float, missing: slice = slice(0)) -> float:
    """Largest difference from the rollout, when that plus noise is what was measured."""
    runs = recording()
    start = rest(twin, runs)
    expected = rolled(twin, runs, start)
    temp = np.concatenate([runs.ambient[:, :1], expected], axis=1)
    temp += noise_k * np.random.default_rng(2).standard_normal(temp.shape)
    temp[:, missing] = np.nan
    steps = linearise(twin, replace(runs, temp=temp))
    shown = responses([EnsembleRun(steps, start, steps.driven)])[0]
    return float(np.abs(shown - expected).max())


LINEAR = [name for name in EFFECTS if not twin_with(name).signals.bends]
BENT = {  # largest error where noise is 0.3 K and where it is 1 K
    "longwave_radiation": (0.0015, 0.005),
    "evapotranspiration": (0.003, 0.01),
    "stack_ventilation": (0.006, 0.025),
    "natural_convection": (0.01, 0.06),
    "respiration_heat": (0.003, 0.006),
    "heater_derating": (0.01, 0.06),
}


def test_every_effect_is_either_linear_or_bent() -> None:
    assert {*LINEAR, *BENT} == set(EFFECTS) - set(UNNAMED_EFFECTS)


@pytest.mark.parametrize("box", [BOX, AIR_ALONE], ids=["box", "air alone"])
@pytest.mark.parametrize("name", LINEAR)
def test_a_linear_effect_is_stepped_as_the_rollout_does(name: str, box: Effects) -> None:
    # What was measured does not matter to it: 1 K of noise.
    tolerance = AGEING_K if name == "ua_drift" else ROUNDING_K
    assert error_k(twin_with(name, box), noise_k=1.0) < tolerance


@pytest.mark.parametrize("name", BENT)
def test_a_bent_effect_is_stepped_along_its_tangent_where_it_was_measured(name: str) -> None:
    near_k, far_k = BENT[name]
    assert error_k(twin_with(name), noise_k=0.3) < near_k
    assert error_k(twin_with(name), noise_k=1.0) < far_k


@pytest.mark.parametrize("name", BENT)
def test_a_bent_effect_bridges_a_hole_of_two_rows_in_which_the_heater_is_switched(name: str) -> None:
    assert error_k(twin_with(name), noise_k=0.0, missing=slice(40, 42)) < 0.03


def test_effects_that_are_late_or_slow_go_together() -> None:
    effects = {
        "wall_mass": {"C_w": 5000.0, "G_in": 10.0, "G_out": 8.0},
        "soil_mass": {"C_s": 20000.0, "G_s": 3.0},
        "heater_lag": {"tau_h": 180.0},
        "heater_deadtime": {"d_h": 75.0},
        "fan_deadtime": {"d_f": 20.0},
        "fan_spinup": {"tau_f": 30.0},
        "sensor_lag": {"tau_s": 60.0},
        "imperfect_mixing": {"F_mix": 0.02},
        "radiative_split": {"f_rad": 0.3},
        "extra_capacity": {"kC": 10.0},
    }
    assert error_k(BoxTwin(effects=effects), noise_k=1.0) < ROUNDING_K


@pytest.mark.parametrize("box", [BOX, AIR_ALONE], ids=["box", "air alone"])
@pytest.mark.parametrize("tau_f", [0.5, 15.0, 120.0, 600.0])
def test_a_fan_that_takes_any_time_is_stepped_as_the_rollout_does(tau_f: float, box: Effects) -> None:
    assert error_k(BoxTwin(effects={**box, "fan_spinup": {"tau_f": tau_f}}), noise_k=1.0) < ROUNDING_K


def test_twins_of_different_sizes_run_side_by_side_as_alone() -> None:
    runs = recording()
    twins = [
        BoxTwin(effects=BOX),
        twin_with("soil_mass"),
        BoxTwin(effects={**AIR_ALONE, "heater_lag": {"tau_h": 60.0}}),
    ]
    wanted = []
    for twin in twins:
        steps = linearise(twin, runs)
        wanted += [EnsembleRun(steps, rest(twin, runs), steps.driven), EnsembleRun(steps, None, steps.heat)]
    together = responses(wanted)
    assert together.shape == (6, RUNS, ROWS)
    for one, shown in zip(wanted, together, strict=True):
        assert shown == pytest.approx(responses([one])[0], abs=1e-12)


@pytest.mark.parametrize("name", ["wall_loss", "heater_lag", "heater_deadtime", "fan_spinup", "sensor_lag"])
def test_each_input_does_what_a_difference_of_two_rollouts_says(name: str) -> None:
    # A linear twin: one unit more of an input moves the run by that input's response, whatever else happens.
    runs, twin = recording(), twin_with(name)
    steps, start = linearise(twin, runs), rest(twin, recording())
    plain = rolled(twin, runs, start)
    heat_w = np.random.default_rng(3).standard_normal((RUNS, ROWS))
    source = heat_w / twin.system.air_capacity_j_k
    warmed = twin.rollout(start, runs.duty, runs.fan, runs.ambient, source, conditions=runs.conditions)
    warmer_room = rolled(twin, replace(runs, ambient=runs.ambient + heat_w), start)
    stronger = rolled(twin, replace(runs, duty=1.5 * runs.duty), start)
    shown = responses(
        [
            EnsembleRun(steps, None, steps.heat * heat_w.T[..., None]),
            EnsembleRun(steps, None, steps.room * heat_w.T[..., None]),
            EnsembleRun(steps, None, 0.5 * steps.duty),
        ]
    )
    expected = np.stack([warmed, warmer_room, stronger]) - plain
    assert shown == pytest.approx(expected, abs=1e-9)


def test_nothing_driven_from_nothing_stays_at_zero() -> None:
    steps = linearise(BoxTwin(effects=BOX), recording())
    assert (responses([EnsembleRun(steps, None, None)]) == 0.0).all()


@pytest.mark.parametrize(
    ("name", "column"), [("led_gain", "light"), ("evapotranspiration", "rel_humidity"), ("ua_drift", "utc")]
)
def test_a_column_that_an_effect_needs_is_named_where_it_is_missing(name: str, column: str) -> None:
    runs = recording()
    without = {key: values for key, values in runs.conditions.items() if key != column}
    with pytest.raises(DataError, match=f"{column}: missing, the twin's {name} needs this column"):
        linearise(twin_with(name), replace(runs, conditions=without))


def test_walls_that_age_need_the_day_they_are_counted_from() -> None:
    with pytest.raises(DataError, match="day0_utc: missing"):
        linearise(replace(twin_with("ua_drift"), day0_utc=None), recording())


def test_a_door_that_nobody_knows_of_stays_closed() -> None:
    runs = recording()
    closed = replace(runs, conditions={**runs.conditions, "door_open": np.zeros((RUNS, ROWS))})
    unknown = replace(runs, conditions={})
    twin = twin_with("door_opening")
    assert linearise(twin, unknown).driven == pytest.approx(linearise(twin, closed).driven)
