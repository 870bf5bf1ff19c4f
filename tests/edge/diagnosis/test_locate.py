"""Places where a twin disagrees: events and regimes, on runs with effects that it lacks."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.locate.events import find_events
from edge.diagnosis.locate.heat_filter import HeatNoise, filter_heat, likeliest, steps_of, white
from edge.diagnosis.locate.shapes import EventShape, shapes_of
from edge.diagnosis.where import conditions, innovations, regimes
from edge.twin.fit import free_run
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
        near = [d for d in found.doors if d.run == f"run_{run}" and abs(d.from_s / 60.0 - begin) <= 1]
        assert [abs(door.to_s / 60.0 - end) <= 1 for door in near] == [True]
        assert near[0].conductance_w_k == pytest.approx(10.0, rel=0.35)
        assert near[0].heat_w < 0.0
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


def test_a_box_of_twice_the_power_loss_and_capacity_has_the_same_events():
    hidden = made(DOOR, count=6, conditions=opened(PLACES), **CALM)
    temp = hidden.temp.copy()
    temp[5, 100] += 2.0
    runs, small = replace(hidden, temp=temp, conditions={}), BoxTwin(effects=BASE)
    plain = small.geometry
    large = replace(
        small,
        geometry=replace(
            plain,
            volume_m3=2.0 * plain.volume_m3,
            heater_max_w=2.0 * plain.heater_max_w,
            fan_max_m3_s=2.0 * plain.fan_max_m3_s,
        ),
        effects={**BASE, "wall_loss": {"UA": 2.0 * BASE["wall_loss"]["UA"]}},
    )
    one, other = (find_events(twin, runs, names(runs), NOISE_K) for twin in (small, large))
    np.testing.assert_allclose(other.door_open, one.door_open, atol=1e-6)
    assert (other.wrong == one.wrong).all()
    assert one.wrong.any()
    pairs = list(zip(one.doors, other.doors, strict=True))
    assert len(pairs) >= 5
    for a, b in pairs:
        assert (b.run, b.from_s, b.to_s) == (a.run, a.from_s, a.to_s)
        assert b.conductance_w_k == pytest.approx(2.0 * a.conductance_w_k)
        assert b.heat_w == pytest.approx(2.0 * a.heat_w)


# the filter


ONE_LEVEL = HeatNoise(np.array([0.01]), np.array([0.02]))


def filtered(runs):
    steps = steps_of(BoxTwin(effects=BASE), runs, NOISE_K)
    return steps, filter_heat(steps, NOISE_K, ONE_LEVEL)


def test_a_right_twin_leaves_no_unknown_heat_and_white_innovations():
    steps = steps_of(BoxTwin(effects=BASE), made(BASE), NOISE_K)
    noise = likeliest(steps, NOISE_K)
    assert noise == (0.0005, 0.0)  # the least of the levels tried
    assert white(filter_heat(steps, NOISE_K, noise)).std() == pytest.approx(1.0, abs=0.05)


def test_a_run_without_room_temperature_is_refused():
    runs = made(BASE, count=1)
    with pytest.raises(DataError, match="temp_ambient_c: not known"):
        found_in(replace(runs, ambient=np.full_like(runs.ambient, np.nan)))


def test_responses_are_what_a_changed_run_shows():
    twin, runs = BoxTwin(effects=BASE), made(BASE, count=1, rows=60)
    steps, plain = filtered(runs)
    changed = {}
    for kind, rows in (("door", slice(20, 21)), ("jump", slice(20, None))):
        source = np.zeros_like(runs.duty)
        source[:, rows] = twin.geometry.heater_max_w / twin.system.air_capacity_j_k
        start = runs.temp[:, :1]
        whole = twin.rollout(start, runs.duty, runs.fan, runs.ambient, source)
        gained = whole - twin.rollout(start, runs.duty, runs.fan, runs.ambient)
        changed[kind] = np.pad(gained, ((0, 0), (1, 0)))
    changed["spike"] = np.zeros_like(runs.temp)
    changed["spike"][0, 21] = 1.0
    [shapes] = shapes_of(steps, plain, np.full_like(runs.duty, -1.0))
    for kind, more in changed.items():
        _, other = filtered(replace(runs, temp=runs.temp + more))
        change = (white(other) - white(plain))[0]
        response = shapes.response(EventShape(kind, 20, 21))
        np.testing.assert_allclose(response, change, atol=1e-9)
        # What fits best is the change itself: of size 1, and as sure as its square says.
        z, size = shapes.scores(kind, change)
        assert (size[20, 0], z[20, 0]) == (pytest.approx(1.0), pytest.approx(np.sqrt(change @ change)))


def test_a_longer_door_is_the_sum_of_its_rows():
    runs = made(BASE, count=1, rows=60)
    steps, way = filtered(runs)
    [shapes] = shapes_of(steps, way, runs.temp[:, 1:] - runs.ambient)
    whole = shapes.response(EventShape("door", 50, 55))
    z, size = shapes.scores("door", whole)
    assert (size[50, 4], z[50, 4]) == (pytest.approx(1.0), pytest.approx(np.sqrt(whole @ whole)))
    assert np.unravel_index(np.abs(z).argmax(), z.shape) == (50, 4)
    assert not z[50:, 10:].any()  # past the end


def test_a_right_twin_leaves_white_innovations_and_a_wrong_one_does_not():
    right, wrong = (
        innovations(BoxTwin(effects=BASE), made(effects), NOISE_K).ravel()
        for effects in (BASE, {**BASE, "wall_loss": {"UA": 8.0}})
    )
    after_one = [float(np.corrcoef(values[1:], values[:-1])[0, 1]) for values in (right, wrong)]
    assert abs(after_one[0]) < 0.1 < 0.3 < after_one[1]


def test_a_missing_reading_has_no_innovation_and_the_next_ones_have():
    runs = made(BASE, count=2)
    temp = runs.temp.copy()
    temp[0, [0, 50, 51]], temp[1, 121:] = np.nan, np.nan
    found = innovations(BoxTwin(effects=BASE), replace(runs, temp=temp), NOISE_K)
    assert np.flatnonzero(np.isnan(found[0])).tolist() == [49, 50]
    assert np.flatnonzero(np.isnan(found[1])).tolist() == [*range(120, 180)]


# regimes


def errors_k(runs):
    """Errors of free runs of the plain box."""
    found = free_run(BoxTwin(effects=BASE), runs, runs.ambient, NOISE_K)
    return np.where(found.measured, found.residual, np.nan)


def regimes_of(runs, error_k=None):
    return regimes(BoxTwin(effects=BASE), runs, names(runs), errors_k(runs) if error_k is None else error_k)


def masks(runs):
    return {item.where: item.mask for item in conditions(runs, names(runs), 60.0)}


def masked(runs, regime):
    """Return the rows of a regime, by its words."""
    every = masks(runs)
    return np.all([every[part] for part in regime["where"].split(" and ")], axis=0)


def test_a_right_twin_has_no_regime():
    assert regimes_of(made(BASE, count=10)) == []


def test_a_hidden_loss_lies_where_the_box_is_warm_and_the_twin_gains_too_much():
    runs = made({**BASE, "wall_loss": {"UA": 6.0}}, count=10)
    first = regimes_of(runs)[0]
    assert "T - T_amb >" in first["where"]
    assert first["share_low"] < first["share_of_squared_error"] < first["share_high"]
    assert first["share_of_squared_error"] > 2.0 * first["share_of_rows"]
    excess = (runs.temp[:, 1:] - runs.ambient)[masked(runs, first)]
    # 2 W/K that the twin does not know, over the rows of the regime; the rows before them are nearly as warm.
    assert first["heat_w"] == pytest.approx(-2.0 * excess.mean(), rel=0.15)


def test_a_weak_fan_lies_where_the_fan_is_on_and_the_twin_gains_too_little():
    first = regimes_of(made({**BASE, "fan_effectiveness": {"eps_f": 0.7}}, count=10))[0]
    assert "the fan is on" in first["where"]
    assert first["heat_w"] > 4.0 * first["heat_w_se"] > 0.0


def test_a_constant_heat_has_its_watts_in_each_regime():
    found = regimes_of(made({**BASE, "constant_heat": {"P0": 5.0}}, count=10))
    assert "the fan is off" in found[0]["where"]
    for regime in found:
        assert regime["heat_w"] == pytest.approx(5.0, abs=0.2)


def test_regimes_do_not_say_the_same_twice():
    runs = made({**BASE, "fan_effectiveness": {"eps_f": 0.7}}, count=10)
    found, squared = [masked(runs, regime) for regime in regimes_of(runs)], errors_k(runs) ** 2
    assert len(found) > 1
    for i, one in enumerate(found):
        for other in found[:i]:
            smaller = min(squared[mask].sum() for mask in (one, other))
            assert squared[one & other].sum() < 0.8 * smaller


def test_few_rows_are_not_believed():
    runs = made(BASE, count=10)
    error_k = errors_k(runs)
    error_k[3, 40:50] += 30.0  # all of the error in ten rows of one run
    assert regimes_of(runs, error_k) == []


def test_no_counted_row_has_no_regime():
    runs = made(BASE, count=1)
    assert regimes_of(runs, np.full_like(runs.duty, np.nan)) == []


def test_just_switched_counts_rows_from_the_switch():
    duty = np.array([[0, 0, 0.4, 0.4, 0.4, 0.2, 0.2, 0.2, 0, 0.2, 0, 0]])
    found = masks(replace(made(BASE, count=1, rows=12), duty=duty))
    assert np.flatnonzero(found["the heater went on in the last 5 min"]).tolist() == [*range(2, 7), 9, 10, 11]
    assert np.flatnonzero(found["the heater went off in the last 5 min"]).tolist() == [8, 9, 10, 11]


def test_light_hour_day_and_humidity_are_asked_where_they_are_known():
    rows = 180
    utc = 1.0e9 + 60.0 * np.arange(rows) + np.array([[0.0], [86400.0], [180000.0]])
    light = np.repeat([[0.0, 1.0]], 3, axis=0).repeat(rows // 2, axis=1)
    more = {"utc": utc, "light": light, "rel_humidity": 50.0 + 5.0 * np.sin(utc / 900.0)}
    runs = made(BASE, count=3, rows=rows)
    wheres = masks(replace(runs, conditions=more)).keys()
    # 1e9 s is 2001-09-09 01:46:40 UTC
    assert {"the light is on", "the time > 2.1 days", "between 00 and 03 h UTC"} <= wheres
    assert any("humidity >" in where for where in wheres)
    assert not any("UTC" in where or "time" in where for where in masks(runs))
