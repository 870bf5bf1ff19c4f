"""`edge.app.commission.learn` from the start that a fleet gave: a box of its kind, and one that is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.app.commission import SEEN_MIN_K, Commissioned, learn
from edge.app.step_test_record import STEP_S
from edge.config.settings import ControlSettings
from edge.core.errors import RequestError
from edge.diagnosis.prior_fit import as_over_days
from edge.formats.run_file import RecordedRun
from edge.twin.model import BoxTwin
from edge.twin.provenance import PRIOR
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest
from tests.support.simulated_runs import silent

pytestmark = pytest.mark.slow
ROOM_C, OFFSET_K = 20.0, 0.4


def an_hour(loss_w_k: float, capacity: float = 4.0) -> RecordedRun:
    """Return an hour of a box whose sensor reads OFFSET_K more than the room's."""
    effects = {"wall_loss": {"UA": loss_w_k}, "extra_capacity": {"kC": capacity}}
    effects["heater_lag"] = {"tau_h": 120.0}
    box = BoxTwin(effects=effects, step_s=STEP_S)
    duty = np.repeat([0.0, 1.0, 0.0, 0.6, 1.0, 0.3], 60)
    room = np.full(len(duty), ROOM_C)
    start = at_rest(box, room[:1], room[:1])
    air = np.concatenate([room[:1], box.rollout(start, duty[None], 0.0 * duty[None], room[None])[0]])[:-1]
    noise = 0.03 * np.random.default_rng(1).standard_normal((2, len(duty)))
    columns = {
        "time_s": STEP_S * np.arange(len(duty)),
        "temp_air_c": air + OFFSET_K + noise[0],
        "temp_ambient_c": room + noise[1],
        "heater_duty": duty,
        "fan_on": 0.0 * duty,
    }
    return RecordedRun(columns, {"start_utc": "2026-07-01T08:00:00Z"}, Path("tests.csv"))


def start_of_kind(capacity: float) -> TwinFile:
    usual = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": capacity}, "heater_lag": {"tau_h": 100.0}}
    uncertain = {
        name: {key: Value(value, rel_sd=0.1) for key, value in own.items()} for name, own in usual.items()
    }
    prior = {PRIOR: {"kind": "tent", "misses_k": 0.2}}
    return TwinFile(effects=uncertain, fan_role="none", provenance=prior)


def slow_kind() -> TwinFile:
    return start_of_kind(600.0)


def learnt(loss_w_k: float, **told: float) -> Commissioned:
    """Return what an hour tells. told : further numbers of the fleet's"""
    start = start_of_kind(4.4)
    prior = {PRIOR: {**start.provenance[PRIOR], **told}}
    return learn(an_hour(loss_w_k), replace(start, provenance=prior), ControlSettings(), silent)


def test_a_box_of_the_kind_keeps_its_effects_and_gets_its_own_values() -> None:
    found = learnt(4.6)
    assert found.twin.provenance[PRIOR] == {"kind": "tent", "misses_k": 0.2}
    assert {*found.twin.effects} == {"wall_loss", "extra_capacity", "heater_lag", "sensor_bias"}
    assert found.twin.effects["wall_loss"]["UA"].value == pytest.approx(4.6, rel=0.02)
    assert found.twin.effects["sensor_bias"]["bias"].value == pytest.approx(OFFSET_K, abs=0.1)
    assert not found.refusals
    assert not found.twin.to_fit()
    assert all(value.rel_sd is None for value in found.twin.values().values())


def test_a_value_that_is_unlike_its_kind_is_found_and_told() -> None:
    found = learnt(1.2)
    assert found.twin.effects["wall_loss"]["UA"].value == pytest.approx(1.2, rel=0.1)
    assert found.twin.effects["extra_capacity"]["kC"].value == pytest.approx(4.0, rel=0.1)
    (doubt,) = found.doubts
    assert doubt.startswith("wall_loss.UA is 0.3 times that of its kind")
    assert not learnt(4.6).doubts


def test_a_box_that_is_followed_badly_is_of_its_kind_as_long_as_its_values_are() -> None:
    """As by the sun that comes out: what warms a box is no sign that it is built otherwise."""
    run = an_hour(4.6)
    warmth = np.interp(np.arange(len(run)), [0.75 * len(run), len(run)], [0.0, 1.2])
    sunny = replace(run, columns={**run.columns, "temp_air_c": run.columns["temp_air_c"] + warmth})
    found = learn(sunny, start_of_kind(4.4), ControlSettings(), silent)
    assert found.expectation.error_k > 2.5 * 0.2  # what twins of its kind usually miss by
    assert PRIOR in found.twin.provenance
    assert found.twin.effects["wall_loss"]["UA"].value == pytest.approx(4.6, rel=0.1)
    assert not found.refusals


def test_an_hour_that_hardly_moves_a_slow_box_is_fitted_where_its_kind_is_slow() -> None:
    run = an_hour(4.6, capacity=500.0)
    assert np.ptp(run.columns["temp_air_c"]) < SEEN_MIN_K
    with pytest.raises(RequestError, match="less than 2 K"):
        learn(run, replace(slow_kind(), provenance={}), ControlSettings(), silent)
    found = learn(run, slow_kind(), ControlSettings(), silent)
    assert PRIOR in found.twin.provenance
    assert not found.refusals
    assert found.twin.effects["extra_capacity"]["kC"].value == pytest.approx(500.0, rel=0.15)


def test_a_heater_that_is_not_connected_is_found_in_a_slow_kind_too() -> None:
    run = an_hour(4.6, capacity=500.0)
    cold = replace(run, columns={**run.columns, "temp_air_c": run.columns["temp_ambient_c"]})
    with pytest.raises(RequestError, match="not connected"):
        learn(cold, slow_kind(), ControlSettings(), silent)


@pytest.mark.parametrize(("told", "taken"), [(0.9, 0.9), (1e9, 2.0), (-1.0, 0.5)])
def test_the_loss_over_days_is_taken_from_the_kind_once(told: float, taken: float) -> None:
    plain, found = learnt(4.6), learnt(4.6, loss_share=told)
    before, after = (one.twin.effects["wall_loss"]["UA"] for one in (plain, found))
    assert after.value == pytest.approx(taken * before.value, rel=1e-4)
    assert after.low is not None and after.high is not None and after.low < after.value < after.high
    assert found.twin.provenance[PRIOR] == {"kind": "tent", "misses_k": 0.2, "loss_times": taken}
    assert as_over_days(found.twin) == found.twin
