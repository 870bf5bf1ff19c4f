"""Grey boxes on boxes that are stepped by other code: their rates, what they contain, which one is chosen."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.diagnosis.choose import choose
from edge.diagnosis.fit import GreyBox, fit, rms
from edge.diagnosis.grey_run import GreyRun, reading_noise_k, rests
from edge.formats.run_file import RecordedRun

Floats = NDArray[np.float64]
STEP_S, ROWS, NOISE_K = 20.0, 240, 0.02
BOX = {"loss": 1 / 900.0, "gain": 0.05}  # 45 K at full heat
TRUTHS: Mapping[str, Mapping[str, float]] = {
    "one mass": {},
    "heater_lag": {"heater": 1 / 120.0},
    "sensor_lag": {"sensor": 1 / 60.0},
    "soil": {"air_body": 1 / 600.0, "body_air": 1 / 2400.0},
    "wall": {"air_body": 1 / 400.0, "body_air": 1 / 1600.0, "body_room": 1 / 5000.0},
    "mantle": {"air_body": 1 / 300.0, "body_air": 1 / 200.0},
    "fan": {"fan": 1 / 500.0},
}


def measured(name: str, seed: int = 1, step_s: float = STEP_S, with_room: bool = True) -> GreyRun:
    """A run of a box with one effect, in Euler steps of a second; heater and fan by chance, for minutes."""
    drawn = np.random.default_rng(seed)
    duty, fan = (np.repeat(drawn.uniform(0.0, 1.0, 12) * (drawn.uniform(size=12) < 0.6), 20) for _ in "ab")
    duty[:6], fan = 0.0, (fan > 0.0).astype(float) * (name == "fan")
    own = {**BOX, **TRUTHS[name]}
    room_c = 21.0 + (2.0 * np.sin(np.arange(ROWS) / 40.0) if with_room else np.zeros(ROWS))
    air = body = sensor = 21.0
    heater, shown = 0.0, []
    for k in range(int(ROWS * STEP_S)):
        row = int(k / STEP_S)
        if k % step_s == 0:
            shown.append(sensor if "sensor" in own else air)
        heat = own["gain"] * duty[row]
        if "heater" in own:
            heater += (heat - heater) * own["heater"]
            heat = heater
        to_air = own.get("air_body", 0.0) * (body - air)
        to_body = own.get("body_air", 0.0) * (air - body) - own.get("body_room", 0.0) * (body - room_c[row])
        in_body = heat if name == "mantle" else 0.0
        air += (own["loss"] + fan[row] * own.get("fan", 0.0)) * (room_c[row] - air) + to_air + heat - in_body
        body += to_body + in_body
        sensor += (air - sensor) * own.get("sensor", 0.0)
    rows = (step_s * np.arange(len(shown)) / STEP_S).astype(int)
    temp = np.array(shown) + NOISE_K * drawn.standard_normal(len(shown))
    room = room_c[rows] if with_room else None
    return GreyRun(temp, duty[rows], room, (), fan[rows] if name == "fan" else None, True)


def terms(name: str) -> frozenset[str]:
    return frozenset() if name == "one mass" else frozenset({name})


@pytest.mark.parametrize("name", TRUTHS)
def test_rates_of_a_box_are_found_from_a_run(name: str) -> None:
    box = fit(terms(name), [measured(name)], STEP_S, NOISE_K)
    assert box.rmse_k < 1.3 * NOISE_K
    for rate, value in {"loss": BOX["loss"], **TRUTHS[name]}.items():
        loose = 0.5 if name == "wall" else 0.1  # what a wall loses and what the air loses are hardly two
        assert box.rates[rate] == pytest.approx(value, rel=loose), rate


@pytest.mark.parametrize("name", ["one mass", "heater_lag", "soil"])
def test_a_room_that_no_one_measured_is_found_where_a_run_begins_at_rest(name: str) -> None:
    box = fit(terms(name), [measured(name, with_room=False)], STEP_S, NOISE_K)
    assert box.rmse_k < 1.3 * NOISE_K
    assert box.starts[0][-1] == pytest.approx(21.0, abs=0.3)
    assert box.rates["loss"] == pytest.approx(BOX["loss"], rel=0.1)  # of two lags the slower is the box


def test_a_dead_time_is_found_beside_a_lag() -> None:
    run = measured("heater_lag")
    late = replace(run, duty=np.concatenate([run.duty[3:], np.zeros(3)]))  # the air answers 60 s later
    box = fit(frozenset({"heater_lag", "dead_time"}), [late], STEP_S, NOISE_K)
    assert box.rates["dead_s"] == pytest.approx(60.0, abs=6.0)


@pytest.mark.parametrize("name", ["heater_lag", "soil", "wall", "mantle", "sensor_lag"])
def test_no_structure_fits_worse_than_one_that_it_contains(name: str) -> None:
    run = measured("soil", seed=2)
    one = fit(frozenset(), [run], STEP_S, NOISE_K)
    assert fit(terms(name), [run], STEP_S, NOISE_K, one).rmse_k <= 1.01 * one.rmse_k


def test_only_ratios_count() -> None:
    """Ten times the heater's duty, an air that is 100 K hotter, a step of half the length: the same rates."""
    run = measured("soil")
    found = fit(terms("soil"), [run], STEP_S, NOISE_K)
    stronger = fit(terms("soil"), [replace(run, duty=10.0 * run.duty)], STEP_S, NOISE_K)
    assert run.room is not None
    hotter = fit(terms("soil"), [replace(run, temp=run.temp + 100.0, room=run.room + 100.0)], STEP_S, NOISE_K)
    finer = fit(terms("soil"), [measured("soil", step_s=STEP_S / 2)], STEP_S / 2, NOISE_K)
    for other, rel in ((stronger, 0.01), (hotter, 0.01), (finer, 0.05)):
        assert other.rates == pytest.approx(found.rates, rel=rel)
    assert stronger.gains[0] == pytest.approx(found.gains[0] / 10.0, rel=0.01)


def test_a_hole_in_the_readings_is_no_row() -> None:
    run = measured("one mass")
    run.temp[50:80] = np.nan
    box = fit(frozenset(), [run], STEP_S, NOISE_K)
    assert box.rates["loss"] == pytest.approx(BOX["loss"], rel=0.05)
    assert np.isnan(box.errors[0][50:80]).all()


def held_out_k(box: GreyBox, run: GreyRun) -> float:
    return rms(run.temp - box.free_run(run, box.start_of(run)))


@pytest.mark.parametrize(
    ("name", "same"),
    [
        ("one mass", {"one mass"}),
        ("heater_lag", {"heater_lag", "sensor_lag", "mantle"}),  # heat that is late: air alone tells no more
        ("soil", {"soil", "wall"}),
    ],
)
def test_free_runs_choose_the_structure(name: str, same: set[str]) -> None:
    found = choose([measured(name, seed) for seed in (1, 2, 3)], STEP_S, NOISE_K)
    assert (" + ".join(sorted(found.terms)) or "one mass") in same
    assert held_out_k(found.box, measured(name, 4)) < 0.1


def recorded(temp: Floats, **columns: Floats) -> RecordedRun:
    return RecordedRun(
        {
            "time_s": 10.0 * np.arange(len(temp)),
            "temp_air_c": temp,
            "heater_duty": np.zeros(len(temp)),
            **columns,
        }
    )


def test_noise_is_that_of_readings_and_at_least_their_rounding() -> None:
    slow = 20.0 + 5.0 * np.sin(np.arange(400) / 60.0)
    noisy = slow + 0.1 * np.random.default_rng(0).standard_normal(400)
    assert reading_noise_k([recorded(noisy)]) == pytest.approx(0.1, rel=0.2)
    stepped = np.round(slow * 2.0) / 2.0
    assert reading_noise_k([recorded(stepped)]) == pytest.approx(0.5 / 12**0.5)
    stepped[1::9] = 0.5 * (stepped[:-1:9] + stepped[1::9])[: len(stepped[1::9])]  # as resampling leaves them
    assert reading_noise_k([recorded(stepped)]) == pytest.approx(0.5 / 12**0.5)


@pytest.mark.parametrize(
    ("temp", "is_resting"),
    [
        ([20.0] * 5 + list(np.linspace(20.0, 40.0, 50)), True),
        (list(np.linspace(20.0, 40.0, 55)), False),  # it moves already
        ([40.0] * 5 + list(np.linspace(40.0, 20.0, 50)), False),  # it holds still, and was heated before
    ],
)
def test_a_run_that_begins_at_rest_is_recognised(temp: list[float], is_resting: bool) -> None:
    assert rests(np.array(temp), 0.01) is is_resting
