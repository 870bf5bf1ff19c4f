"""The scorer's alias classes: its likelihood against a dense one, and classes known beforehand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from bench.hidden_effects.cases import HiddenEffect, Truth
from bench.hidden_effects.score_aliases import AliasClass, alias_classes, cached_classes
from bench.hidden_effects.score_likelihood import ReadingNoise, likeliest, log_likelihood, structure
from edge.formats.run_file import RecordedRun
from edge.twin.model import BoxTwin
from edge.twin.run_batch import batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

ROWS, RUNS = 150, 3
KNOWN = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 5.0}}
FILE = TwinFile(effects={name: {key: Value(x) for key, x in own.items()} for name, own in KNOWN.items()})


def run_of(effects: dict[str, dict[str, float]], seed: int, noise_k: float = 0.05) -> RecordedRun:
    """A run of a twin with random steps in both inputs, from the room's temperature."""
    rng = np.random.default_rng(seed)
    duty = np.repeat(rng.integers(0, 13, ROWS // 10 + 1) / 20.0, 10)[:ROWS]
    fan = np.repeat(rng.random(ROWS // 15 + 1) < 0.3, 15)[:ROWS].astype(float)
    room = np.full(ROWS, 20.0 + seed)
    twin = BoxTwin(effects=effects)
    start = np.full(len(twin.states), room[0])
    temp = np.concatenate([start[:1], twin.rollout(start[None], duty[None], fan[None], room[None])[0, :-1]])
    columns = {"time_s": 60.0 * np.arange(ROWS), "temp_air_c": temp + noise_k * rng.normal(size=ROWS),
               "temp_ambient_c": room, "heater_duty": duty, "fan_on": fan}  # fmt: skip
    return RecordedRun(columns)


def case(**hidden: dict[str, float]) -> tuple[Truth, list[RecordedRun]]:
    runs = [run_of({**KNOWN, **hidden}, seed) for seed in range(RUNS)]
    items = tuple(HiddenEffect(name, own, 1.0) for name, own in hidden.items())
    return Truth("case_1", "equations", "dev", "single", 1, items, None, (), tuple(KNOWN), {}, {}, {}), runs


def dense(
    noise: ReadingNoise, rows: NDArray[np.intp], residual: NDArray[np.float64], response: NDArray[np.float64]
) -> float:
    """Return the log likelihood of these rows of one run, by their whole covariance; without the constant."""
    apart = np.abs(np.subtract.outer(rows, rows))
    covariance = noise.white_k**2 * np.eye(len(rows)) + noise.wandering_k**2 * noise.phi**apart
    covariance += response[:, rows].T @ response[:, rows]
    constant = 0.5 * len(rows) * np.log(2.0 * np.pi)
    return float(multivariate_normal(cov=covariance).logpdf(residual[rows])) + constant


def test_the_likelihood_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(1)
    noise, residual, response = (
        ReadingNoise(0.2, 0.4, 7.0),
        rng.normal(size=(2, 40)),
        rng.normal(size=(2, 3, 40)),
    )
    measured = np.ones((2, 40), dtype=bool)
    measured[1, 5:9] = False
    expected = sum(dense(noise, np.flatnonzero(measured[b]), residual[b], response[b]) for b in (0, 1))
    found = log_likelihood(noise, np.where(measured, residual, 0.0), response, measured)
    assert found == pytest.approx(expected, rel=1e-9)


def test_noise_is_found_again():
    rng = np.random.default_rng(2)
    wander = np.zeros((4, 400))
    for k in range(1, 400):
        wander[:, k] = np.exp(-1.0 / 20.0) * wander[:, k - 1] + 0.3 * rng.normal(
            scale=np.sqrt(1.0 - np.exp(-0.1)), size=4
        )
    residual = wander + 0.1 * rng.normal(size=wander.shape)
    measured = np.ones(residual.shape, dtype=bool)
    found = likeliest(ReadingNoise(0.3, 0.1, 5.0), residual, np.zeros((4, 0, 400)), measured)
    assert found == pytest.approx((0.1, 0.3, 20.0), rel=0.35)


def test_lost_radiant_heat_cannot_be_told_from_a_weak_heater():
    # Without wall and soil nodes the radiant share is lost: (1 - f_rad) H is eta H.
    (own,) = alias_classes(*with_file(case(heater_efficiency={"eta": 0.8})))
    assert own.behind["radiative_split"] == pytest.approx(0.0, abs=0.2)
    assert own.gain_nats is not None
    assert own.gain_nats > 50.0
    assert "led_gain" not in own.up_to(10.0)  # the runs have no light
    assert "wall_mass" not in own.members


def test_an_effect_of_its_own_kind_has_no_rival():
    (own,) = alias_classes(*with_file(case(heater_lag={"tau_h": 240.0})))
    assert own.members == {"heater_lag"}


def test_an_effect_that_does_next_to_nothing_has_no_class():
    (own,) = alias_classes(*with_file(case(heater_sag={"sag": 1e-4})))
    assert own == AliasClass("heater_sag", {}, own.gain_nats)
    assert not own.shows


def test_a_door_at_unknown_times_has_no_rivals():
    truth, runs = case(heater_lag={"tau_h": 240.0})
    door = replace(truth, hidden=(HiddenEffect("door_opening", {"G_door": 20.0}, 1.0),))
    assert alias_classes(door, FILE, runs) == (AliasClass("door_opening"),)
    assert AliasClass("door_opening").shows


def test_a_case_that_hides_nothing_has_no_class():
    truth, runs = case()
    assert alias_classes(truth, FILE, runs) == ()


def test_bent_heat_at_the_measured_temperature_is_that_of_a_free_run():
    # Radiation of 3 W/K: the short cut and the twin's own small steps differ by less than the noise.
    effects = {**KNOWN, "longwave_radiation": {"epsA": 0.5}}
    runs = [run_of(effects, seed, noise_k=0.0) for seed in range(RUNS)]
    file = replace(FILE, effects={name: {key: Value(x) for key, x in own.items()}
                                  for name, own in effects.items()})  # fmt: skip
    residual = structure(file, batch_runs(runs, 60.0)).residual(np.zeros(0))
    assert np.abs(residual).max() < 0.05


def test_classes_are_computed_once_for_a_key(tmp_path: Path):
    truth, runs = case(heater_sag={"sag": 1e-4})
    cache = tmp_path / "classes" / "case_1.json"
    first = cached_classes(cache, "a", truth, FILE, runs)
    document = json.loads(cache.read_text())
    document["classes"][0]["effect"] = "led_gain"
    cache.write_text(json.dumps(document))
    assert cached_classes(cache, "a", truth, FILE, runs)[0].effect == "led_gain"  # from the file
    assert cached_classes(cache, "b", truth, FILE, runs) == first


def with_file(given: tuple[Truth, list[RecordedRun]]) -> tuple[Truth, TwinFile, list[RecordedRun]]:
    return given[0], FILE, given[1]
