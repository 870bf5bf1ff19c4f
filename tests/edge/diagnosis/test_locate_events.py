from dataclasses import replace

import numpy as np
import pytest
from locate_runs import BASE, NOISE_K, made, names

from edge.diagnosis.locate.events import find_events
from edge.twin.model import BoxTwin

pytestmark = pytest.mark.slow

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
