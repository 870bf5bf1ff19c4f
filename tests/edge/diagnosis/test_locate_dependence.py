from dataclasses import replace

import numpy as np
import pytest
from locate_runs import BASE, NOISE_K, located, made, whiteness_of

from edge.diagnosis.locate.dependence import SumRegression, depends_on, explain
from edge.diagnosis.locate.regimes import regimes
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch

DAY_S = 86400.0


def with_heat(watts, seed=0, count=8, rows=150, noise_k=NOISE_K):
    """Runs in which the air takes heat that is no effect of the library, given at a sixth of a step."""
    rng, twin = np.random.default_rng(seed), BoxTwin(effects=BASE, step_s=10.0)
    plain = made(BASE, count=count, rows=rows, seed=seed, noise_k=0.0)
    utc = 1.75e9 + 30.0 * 3600.0 * np.arange(count)[:, None] + 60.0 * np.arange(rows)
    seen = {
        "light": np.repeat(rng.choice([0.0, 1.0], (count, rows // 30)), 30, axis=1),
        "rel_humidity": 55.0 + np.cumsum(rng.normal(0.0, 0.4, (count, rows)), axis=1),
        "utc": utc,
    }
    temp, temps = plain.temp[:, 0], [plain.temp[:, 0]]
    for k in range(rows):
        now = {name: column[:, k] for name, column in seen.items()}
        now |= {"u": plain.duty[:, k], "fan": plain.fan[:, k], "room": plain.ambient[:, k]}
        for _ in range(6):
            source = watts(temp - now["room"], now) / twin.system.air_capacity_j_k
            temp = twin.step(temp, now["room"], now["u"], now["fan"], source)
        temps.append(temp)
    whole = np.stack(temps, axis=1)
    return RunBatch(whole + rng.normal(0.0, noise_k, whole.shape), plain.duty, plain.fan, plain.ambient, seen)


HEATS = {
    "duty squared": (lambda excess, now: -30.0 * now["u"] ** 2, {"heater_duty"}),
    "weak when warm": (lambda excess, now: -0.8 * now["u"] * excess, {"heater_duty", "temp_air"}),
    "leak": (lambda excess, now: -1.5 * (1.0 - now["fan"]) * excess, {"fan_on", "temp_air"}),
    "fan's heat": (lambda excess, now: 6.0 * now["fan"], {"fan_on"}),
    "humidity": (lambda excess, now: -0.5 * (now["rel_humidity"] - 50.0), {"rel_humidity"}),
    "light": (lambda excess, now: -0.8 * now["light"] * excess, {"light", "temp_air"}),
    "hour": (lambda excess, now: 8.0 * np.sin(2.0 * np.pi * (now["utc"] % DAY_S) / DAY_S), {"time"}),
    "ageing": (lambda excess, now: -0.3 * excess * (now["utc"] - 1.75e9) / DAY_S, {"time", "temp_air"}),
}


@pytest.mark.parametrize(("watts", "true"), HEATS.values(), ids=HEATS)
def test_the_first_two_dependences_are_true_ones(watts, true):
    found = depends_on(located(with_heat(watts)))
    assert found
    assert {item.name for item in found[:2]} <= true
    assert all(0.0 < item.strength <= 1.0 and item.p_value < 0.01 for item in found)
    assert [item.strength for item in found] == sorted((item.strength for item in found), reverse=True)


def test_the_best_formula_has_its_watts():
    found = explain(located(with_heat(HEATS["leak"][0])))
    assert found.terms == ("(1 - u_f) (T - T_amb)",)
    assert found.coefficients_w[0] == pytest.approx(-1.5, rel=0.1)
    assert 0.1 < found.share < 1.0


def test_heat_that_depends_on_nothing_says_so():
    assert depends_on(located(made({**BASE, "constant_heat": {"P0": 5.0}}))) == []


def test_a_heater_that_differs_from_run_to_run_and_slow_noise_are_no_dependence():
    alarms = 0
    for seed in range(3):
        rng = np.random.default_rng(100 + seed)
        power, wander = rng.normal(0.0, 1.5, 6), np.zeros(6)

        def watts(excess, now, rng=rng, power=power, wander=wander):
            # 2 W that go together for 600 s, in steps of 10 s
            keeps = np.exp(-10.0 / 600.0)
            wander *= keeps
            wander += 2.0 * np.sqrt(1.0 - keeps**2) * rng.normal(size=6)
            return power * now["u"] + wander

        alarms += bool(depends_on(located(with_heat(watts, seed=seed, count=6))))
    assert alarms == 0


def test_runs_of_different_length_are_taken_together():
    runs = with_heat(HEATS["leak"][0])
    temp = runs.temp.copy()
    temp[0, 61:], temp[1, 1:] = np.nan, np.nan
    found = located(replace(runs, temp=temp))
    assert [len(run.white) for run in found[:3]] == [60, 0, 150]
    assert {item.name for item in depends_on(found)} >= {"fan_on", "temp_air"}
    assert regimes(found)
    assert whiteness_of(found[1]).ljung_box_p is None


def test_too_few_rows_depend_on_nothing():
    runs = located(with_heat(HEATS["leak"][0], count=1, rows=30))
    short = [
        replace(run, white=run.white[:20], response=run.response[:20, :20], duty=run.duty[:20])
        for run in runs
    ]
    assert depends_on(short) == []
    assert depends_on([]) == []


def test_columns_that_are_not_recorded_or_do_not_vary_are_left_out():
    runs = located(replace(with_heat(HEATS["duty squared"][0]), conditions={}))
    still = [replace(run, fan=np.zeros_like(run.fan)) for run in runs]
    assert {item.name for item in depends_on(runs)} <= {"heater_duty", "temp_air", "temp_ambient"}
    assert all(item.name != "fan_on" for item in depends_on(still))


def test_a_subset_is_found_among_decoys():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(400, 40))
    columns /= np.linalg.norm(columns, axis=0)
    regression = SumRegression.of(
        columns, 20.0 * columns[:, 3] - 15.0 * columns[:, 17] + rng.normal(size=400), 400
    )
    assert regression.best(range(40)) == (3, 17)
    assert 3 not in regression.best([i for i in range(40) if i != 3])
    noise = SumRegression.of(columns, rng.normal(size=400), 400)
    assert noise.best(range(40)) == ()
    assert noise.remainder(()) == noise.total
