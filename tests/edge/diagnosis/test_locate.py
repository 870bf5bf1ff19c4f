"""Places where a twin disagrees: events, heat, regimes, on runs with effects that it lacks."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.locate.candidates import jumps, pulses, score, spikes, white
from edge.diagnosis.locate.events import find_events
from edge.diagnosis.locate.regimes import conditions, regimes
from edge.diagnosis.locate.residual_heat import HeatNoise, residual_heat
from edge.diagnosis.locate.residuals import residuals_of
from edge.diagnosis.locate.rows import rows_of
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest

BASE = {"extra_capacity": {"kC": 10.0}, "wall_loss": {"UA": 4.0}}
NOISE_K = 0.1


def made(effects, count=8, rows=180, seed=0, noise_k=NOISE_K, conditions=None, fan_share=0.3, held=(10, 5)):
    """Runs from rest: duties that hold 10 rows and fans that hold 5, a room that wanders, noise."""
    rng, twin = np.random.default_rng(seed), BoxTwin(effects=effects)
    duty = _kept(rng.choice([0.0, 0.2, 0.4, 0.6], (count, rows)), held[0], rows)
    fan = _kept((rng.uniform(size=(count, rows)) < fan_share).astype(float), held[1], rows)
    room = 21.0 + 0.5 * np.sin(np.arange(rows) / 40.0 + rng.uniform(0.0, 6.0, (count, 1)))
    start = np.stack([at_rest(twin, 22.0, now) for now in room[:, 0]])
    temps = twin.rollout(start, duty, fan, room, conditions=conditions)
    whole = np.concatenate([np.full((count, 1), 22.0), temps], axis=1)
    noise = rng.normal(0.0, noise_k, whole.shape) if noise_k else 0.0
    return RunBatch(whole + noise, duty, fan, room, conditions or {})


def _kept(values, rows_each, rows):
    return np.repeat(values, rows_each, axis=1)[:, :rows]


def names(runs):
    return [f"run_{i}" for i in range(len(runs.temp))]


def located(runs, effects=BASE, noise_k=NOISE_K):
    """Residuals of a twin with these effects alone."""
    return residuals_of(BoxTwin(effects=effects), runs, names(runs), noise_k)


# doors, spikes and jumps


DOOR = {**BASE, "door_opening": {"G_door": 10.0}}
WALLED = {
    "extra_capacity": {"kC": 4.0},
    "wall_mass": {"C_w": 9000.0, "G_in": 9.0, "G_out": 8.0},
    "heater_lag": {"tau_h": 200.0},
}
CALM = {"held": (60, 180), "fan_share": 0.0}  # a heater that changes each hour, the fan off


def found_in(runs, effects=BASE):
    return find_events(BoxTwin(effects=effects), runs, names(runs), NOISE_K)


def opened(places, count=6, rows=180):
    column = np.zeros((count, rows))
    for run, begin, end in places:
        column[run, begin:end] = 1.0
    return {"door_open": column}


PLACES = [(0, 95, 101), (1, 75, 78), (2, 130, 145), (3, 90, 96), (3, 150, 155), (4, 70, 74)]


@pytest.mark.parametrize("effects", [BASE, WALLED], ids=["one node", "walled"])
def test_openings_are_found_within_a_row(effects):
    hidden = made({**effects, "door_opening": {"G_door": 10.0}}, count=6, conditions=opened(PLACES), **CALM)
    # Warm enough for a door to matter: at least 2 K above the room when it opens.
    places = [p for p in PLACES if hidden.temp[p[0], p[1]] - hidden.ambient[p[0], p[1]] > 2.0]
    assert len(places) >= 5
    found = found_in(replace(hidden, conditions={}), effects)
    for run, begin, end in places:
        near = [d for d in found.doors if d.run == f"run_{run}" and abs(d.from_row - begin) <= 1]
        assert [abs(door.to_row - end) <= 1 for door in near] == [True]
        assert near[0].conductance_w_k == pytest.approx(10.0, rel=0.35)
        assert near[0].heat_w < 0.0
        assert near[0].from_s == 60.0 * near[0].from_row
    assert len(found.doors) <= len(PLACES)


def test_the_column_makes_the_twin_forecast_the_openings():
    hidden = made(DOOR, count=6, conditions=opened(PLACES), noise_k=0.05, **CALM)
    found = found_in(replace(hidden, conditions={}))
    start = hidden.temp[:, :1]
    errors = [
        BoxTwin(effects=DOOR).rollout(start, hidden.duty, hidden.fan, hidden.ambient, conditions=conditions)
        - hidden.temp[:, 1:]
        for conditions in (None, {"door_open": found.door_open})
    ]
    assert ((found.door_open >= 0.0) & (found.door_open <= 1.0)).all()
    before, after = (np.sqrt((error**2).mean()) for error in errors)
    assert after < 0.4 * before


def test_half_a_step_is_half_a_share():
    column = opened([(0, 90, 98), (1, 90, 98)], count=2)
    column["door_open"][:, 89] = 0.5
    hidden = made(
        {**BASE, "door_opening": {"G_door": 20.0}}, count=2, conditions=column, noise_k=0.02, **CALM
    )
    found = find_events(BoxTwin(effects=BASE), replace(hidden, conditions={}), names(hidden), 0.02)
    for i in range(2):
        if hidden.temp[i, 89] - hidden.ambient[i, 89] > 2.0:
            assert found.door_open[i, 89] == pytest.approx(0.5, abs=0.15)
            assert (found.door_open[i, 90:97] == 1.0).all()
    assert found.doors


def test_twenty_quiet_runs_have_no_door():
    found = found_in(made(BASE, count=20))
    assert found.doors == ()
    assert not found.door_open.any()
    assert not found.wrong.any()


@pytest.mark.parametrize(
    "hidden",
    [
        {"heater_lag": {"tau_h": 300.0}},
        {"heater_saturation": {"u_sat": 0.4}},
        {"infiltration": {"F_inf": 0.002}},
        {"fan_spinup": {"tau_f": 60.0}},
        {"heater_deadtime": {"d_h": 90.0}},
        {"soil_mass": {"C_s": 10000.0, "G_s": 5.0}},
    ],
    ids=lambda hidden: next(iter(hidden)),
)
def test_what_follows_a_step_of_heater_or_fan_is_no_door(hidden):
    runs = made({**BASE, **hidden}, count=10)
    assert found_in(runs).doors == ()


@pytest.mark.parametrize("size_k", [-2.0, 2.0])
def test_a_spike_of_one_reading_is_a_wrong_reading_and_no_door(size_k):
    runs = made(BASE, count=3, **CALM)
    temp = runs.temp.copy()
    temp[1, 100] += size_k
    found = found_in(replace(runs, temp=temp))
    assert found.doors == ()
    assert np.argwhere(found.wrong).tolist() == [[1, 100]]


def test_heat_that_comes_and_stays_is_no_door():
    twin, runs = BoxTwin(effects=BASE), made(BASE, count=3, noise_k=0.0, **CALM)
    lost = np.zeros_like(runs.duty)
    lost[:, 100:] = -15.0 / twin.system.air_capacity_j_k
    temps = twin.rollout(runs.temp[:, :1], runs.duty, runs.fan, runs.ambient, lost)
    noise = np.random.default_rng(0).normal(0.0, NOISE_K, runs.temp.shape)
    whole = np.concatenate([runs.temp[:, :1], temps], axis=1) + noise
    assert found_in(replace(runs, temp=whole)).doors == ()


# the heat that explains a run


BENT = {**BASE, "natural_convection": {"G_nc": 2.0}}
HIDDEN = {
    "lag and wall": {
        "extra_capacity": {"kC": 4.0},
        "wall_mass": {"C_w": 9000.0, "G_in": 9.0, "G_out": 8.0},
        "heater_lag": {"tau_h": 200.0},
    },
    "one node": BASE,
    "bent": BENT,
    "late": {**BASE, "heater_deadtime": {"d_h": 45.0}},
    "fast": {"wall_loss": {"UA": 5.0}},
}


@pytest.mark.parametrize("effects", HIDDEN.values(), ids=HIDDEN)
def test_a_hidden_constant_heat_comes_out_in_watts(effects):
    runs = made({**effects, "constant_heat": {"P0": 5.0}})
    found = residual_heat(BoxTwin(effects=effects), runs, NOISE_K)
    assert found.heat_w.mean() == pytest.approx(5.0, abs=0.15)
    assert np.abs(found.heat_w - 5.0).max() < 1.5
    # Errors in units of the stated sd: not far from 1 on average.
    assert np.sqrt((((found.heat_w - 5.0) / found.sd_w) ** 2).mean()) < 2.0


@pytest.mark.parametrize("effects", [BASE, HIDDEN["fast"]], ids=["slow", "fast"])
def test_a_hidden_wall_loss_is_a_heat_of_minus_2_w_per_k(effects):
    more = {**effects, "wall_loss": {"UA": effects["wall_loss"]["UA"] + 2.0}}
    runs = located(made(more), effects)
    heat, excess = (
        np.concatenate(part) for part in zip(*((r.heat_w, r.excess_k) for r in runs), strict=True)
    )
    assert (heat @ excess) / (excess @ excess) == pytest.approx(-2.0, abs=0.06)
    # Two thirds of the errors would be within one sd, if the heat really wandered at random.
    sd = residual_heat(BoxTwin(effects=effects), made(more), NOISE_K).sd_w.ravel()
    assert 0.5 < np.mean(np.abs(heat + 2.0 * excess) < sd) < 0.95


def test_a_right_twin_leaves_no_heat_and_white_innovations():
    found = residual_heat(BoxTwin(effects=BASE), made(BASE), NOISE_K)
    assert np.abs(found.heat_w).max() < 0.5
    assert found.noise == HeatNoise(0.03, 0.0)  # the least of the levels tried
    assert white(found.way).std() == pytest.approx(1.0, abs=0.05)


def test_missing_readings_and_the_end_of_a_shorter_run():
    runs = made({**BASE, "constant_heat": {"P0": 5.0}}, count=2)
    temp = runs.temp.copy()
    temp[0, 50:70], temp[1, 121:] = np.nan, np.nan
    found = residual_heat(BoxTwin(effects=BASE), replace(runs, temp=temp), NOISE_K, HeatNoise(1.0, 0.0))
    assert np.isfinite(found.heat_w[0]).all()
    assert found.sd_w[0, 60] > 1.5 * found.sd_w[0, 30]  # a hole makes it less sure
    assert np.isfinite(found.heat_w[1, :120]).all()
    assert np.isnan(found.heat_w[1, 120:]).all()
    short = located(replace(runs, temp=temp))[1]
    assert len(short.heat_w) == len(short.duty) == len(short.innovation) == 120


def test_a_run_without_room_temperature_is_refused():
    runs = made(BASE, count=1)
    with pytest.raises(DataError, match="temp_ambient_c: not known"):
        residual_heat(BoxTwin(effects=BASE), replace(runs, ambient=np.full_like(runs.ambient, np.nan)))


def test_responses_are_what_a_changed_run_shows():
    twin, runs, noise = BoxTwin(effects=BASE), made(BASE, count=1, rows=60), HeatNoise(1.0, 2.0)
    plain = residual_heat(twin, runs, NOISE_K, noise)
    heated = {}
    for kind, rows in (("pulse", slice(20, 21)), ("jump", slice(20, None))):
        source = np.zeros_like(runs.duty)
        source[:, rows] = 1.0 / twin.system.air_capacity_j_k
        start = runs.temp[:, :1]
        whole = twin.rollout(start, runs.duty, runs.fan, runs.ambient, source)
        gained = whole - twin.rollout(start, runs.duty, runs.fan, runs.ambient)
        heated[kind] = np.pad(gained, ((0, 0), (1, 0)))
    heated["spike"] = np.zeros_like(runs.temp)
    heated["spike"][0, 21] = 1.0
    for kind, response in (("pulse", pulses), ("jump", jumps), ("spike", spikes)):
        other = residual_heat(twin, replace(runs, temp=runs.temp + heated[kind]), NOISE_K, noise)
        change = (white(other.way) - white(plain.way))[0, 20:]
        np.testing.assert_allclose(response(plain.steps, plain.way)[0, 20, :40], change, atol=1e-9)


def test_a_score_weighs_the_rows_from_its_own_on():
    rng = np.random.default_rng(0)
    response, innovations = rng.normal(size=(30, 7)), rng.normal(size=30)
    expected = [response[i, : 30 - i] @ innovations[i : i + 7] for i in range(30)]
    assert score(response, innovations) == pytest.approx(expected)


def test_residuals_carry_the_inputs_and_the_time():
    light, utc = np.ones((2, 180)), 1.0e9 + 60.0 * np.arange(180) + np.array([[0.0], [1.0e5]])
    runs = replace(made(BASE, count=2), conditions={"light": light, "utc": utc})
    first, second = located(runs)
    assert (first.name, second.step_s) == (names(runs)[0], 60.0)
    assert second.utc_s[[0, -1]] == pytest.approx(1.0e9 + 1.0e5 + np.array([0.0, 179.0 * 60.0]))
    assert first.light is not None
    assert first.rel_humidity is None
    assert np.nanstd(first.free_run_k) == pytest.approx(NOISE_K, rel=0.2)  # nothing is missing but noise


# regimes


def masked(runs, regime):
    """Return the rows of a regime, by its words."""
    masks = {item.where: item.mask for item in conditions(rows_of(runs))}
    return np.all([masks[part] for part in regime["where"].split(" and ")], axis=0)


def test_a_right_twin_has_no_regime():
    assert regimes(located(made(BASE, count=10))) == []


def test_a_hidden_loss_lies_where_the_box_is_warm_and_the_twin_gains_too_much():
    runs = located(made({**BASE, "wall_loss": {"UA": 6.0}}, count=10))
    first = regimes(runs)[0]
    assert "T - T_amb >" in first["where"]
    assert first["share_low"] < first["share_of_squared_error"] < first["share_high"]
    assert first["share_of_squared_error"] > 2.0 * first["share_of_rows"]
    excess = rows_of(runs).inputs["excess_k"][masked(runs, first)]
    # 2 W/K that the twin does not know, over the rows of the regime.
    assert first["heat_w"] == pytest.approx(-2.0 * excess.mean(), abs=3.0 * first["heat_w_se"] + 0.3)


def test_a_weak_fan_lies_where_the_fan_is_on_and_the_twin_gains_too_little():
    runs = located(made({**BASE, "fan_effectiveness": {"eps_f": 0.7}}, count=10))
    first = regimes(runs)[0]
    assert "the fan" in first["where"]
    assert first["heat_w"] > 4.0 * first["heat_w_se"] > 0.0


def test_a_constant_heat_has_its_watts_in_each_regime():
    found = regimes(located(made({**BASE, "constant_heat": {"P0": 5.0}}, count=10)))
    assert found[0]["where"].startswith("the fan is off")
    for regime in found:
        assert regime["heat_w"] == pytest.approx(5.0, abs=0.2)


def test_regimes_do_not_say_the_same_twice():
    runs = located(made({**BASE, "wall_loss": {"UA": 6.0}}, count=10))
    found = [masked(runs, regime) for regime in regimes(runs)]
    squared = rows_of(runs).error_k ** 2
    for i, one in enumerate(found):
        for other in found[:i]:
            smaller = min(squared[mask].sum() for mask in (one, other))
            assert squared[one & other].sum() < 0.8 * smaller


def test_few_rows_are_not_believed():
    runs = [run for run in located(made(BASE, count=10))]
    broken = runs[3].free_run_k.copy()
    broken[40:50] += 30.0  # all of the error in ten rows of one run
    runs[3] = replace(runs[3], free_run_k=broken)
    assert regimes(runs) == []


def test_no_run_and_no_counted_row_have_no_regime():
    assert regimes([]) == []
    run = located(made(BASE, count=1))[0]
    unknown = replace(run, free_run_k=np.full_like(run.free_run_k, np.nan))
    assert regimes([unknown]) == []


def test_just_switched_counts_rows_from_the_switch():
    run = located(made(BASE, count=1, rows=12))[0]
    duty = np.array([0, 0, 0.4, 0.4, 0.4, 0.2, 0, 0, 0.2, 0, 0, 0])
    rows = rows_of([replace(run, duty=duty)])
    masks = {item.where: np.flatnonzero(item.mask).tolist() for item in conditions(rows)}
    assert masks["the heater has just gone on (first row)"] == [2, 8]
    assert masks["the heater has just gone on (first 2 rows)"] == [2, 3, 8]
    assert masks["the heater has just gone off (first 5 rows)"] == [6, 7, 9, 10, 11]  # not the start
    assert masks["the duty is 0 to 0.25"] == [5, 8]
    assert "the duty is 0.5 to 0.75" not in masks  # never


def test_light_hour_day_and_humidity_are_asked_where_they_are_known():
    rows = 180
    utc = 1.0e9 + 60.0 * np.arange(rows) + np.array([[0.0], [86400.0], [180000.0]])
    light = np.repeat([[0.0, 1.0]], 3, axis=0).repeat(rows // 2, axis=1)
    more = {"utc": utc, "light": light, "rel_humidity": 50.0 + 5.0 * np.sin(utc / 900.0)}
    runs = located(replace(made(BASE, count=3, rows=rows), conditions=more))
    wheres = {item.where for item in conditions(rows_of(runs))}
    # 1e9 s is 2001-09-09 01:46:40 UTC
    assert {"the light is on", "on day 1", "on day 3", "between 00 and 03 h UTC"} <= wheres
    assert any("humidity >" in where for where in wheres)
    assert not any("UTC" in item.where for item in conditions(rows_of(located(made(BASE, count=3)))))


def test_a_right_twin_leaves_white_innovations_and_a_wrong_one_does_not():
    right, wrong = (
        np.concatenate([run.innovation for run in located(made(effects))])
        for effects in (BASE, {**BASE, "wall_loss": {"UA": 8.0}})
    )
    after_one = [float(np.corrcoef(values[1:], values[:-1])[0, 1]) for values in (right, wrong)]
    assert abs(after_one[0]) < 0.1 < 0.3 < after_one[1]
