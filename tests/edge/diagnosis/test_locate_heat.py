from dataclasses import replace

import numpy as np
import pytest
from locate_runs import BASE, NOISE_K, located, made, names

from edge.core.errors import DataError
from edge.diagnosis.locate.candidates import jumps, pulses, score, spikes, white
from edge.diagnosis.locate.residual_heat import HeatNoise, residual_heat
from edge.twin.model import BoxTwin

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
    sd = np.concatenate([run.heat_w_sd for run in runs])
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
    assert len(short.heat_w) == len(short.duty) == len(short.measured) - 1 == 120


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
    assert (first.name, second.start_utc, second.time_s[-1]) == (names(runs)[0], 1.0e9 + 1.0e5, 179.0 * 60.0)
    assert first.light is not None
    assert first.rel_humidity is None
    assert np.nanstd(first.free_run_k) == pytest.approx(NOISE_K, rel=0.2)  # nothing is missing but noise
