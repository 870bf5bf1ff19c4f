"""The bounds of safety from a box's twin file."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from edge.app.box import bounds_of, box_bounds
from edge.config.settings import BoxSettings
from edge.core.errors import ConfigError
from edge.safety.box_bounds import PAPER_BOX, unknown_box
from edge.safety.thermal_supervision import Observation, ThermalMemory, look
from edge.twin.new_file import BoxDescription, text
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.warm_start import at_rest

DIAGNOSED = Path("training/results/paper_case/interpolation/twin.yaml")


def test_without_a_file_it_is_the_papers_box():
    assert bounds_of(BoxSettings(heater_w=100.0)) == PAPER_BOX


def test_the_papers_box_fitted_has_about_the_bounds_that_stand_for_it():
    found = bounds_of(BoxSettings(str(DIAGNOSED)))
    quick = {"air_rate_max_k_s"}  # 0.4 K/s, of a fan in a box 20 K over its room
    for item in (item for item in fields(PAPER_BOX) if item.name not in quick):
        told, stands = getattr(found, item.name), getattr(PAPER_BOX, item.name)
        assert told == stands or 0.6 < told / stands < 1.8, item.name


def test_a_box_ten_times_as_large_has_ten_times_the_bounds(tmp_path):
    small, large = (described(tmp_path, size) for size in (1.0, 10.0))
    for name in ("capacity_max_j_k", "capacity_min_j_k", "loss_max_w_k", "loss_min_w_k", "power_max_w"):
        assert getattr(large, name) == pytest.approx(10.0 * getattr(small, name), rel=1e-6), name


def described(folder: Path, size: float):
    path = folder / f"{size:g}.yaml"
    path.write_text(
        f"geometry: {{volume_m3: {0.05 * size}, heater_max_w: {40.0 * size}, fan_max_m3_s: {0.004 * size}}}\n"
        f"effects: {{wall_loss: {{UA: {2.0 * size}}}, extra_capacity: {{kC: 12.0}}}}\n"
    )
    return bounds_of(BoxSettings(str(path)))


def test_a_box_that_is_not_fitted_yet_tells_its_heater_alone(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text(text(BoxDescription(0.4, 250.0, "none")))
    assert box_bounds(read_twin_file(path)) == unknown_box(250.0, "none")


@pytest.mark.parametrize(("duty", "fan", "air"), [(1.0, False, 21.0), (0.0, False, 60.0), (0.0, True, 60.0)])
def test_of_an_unknown_box_nothing_is_claimed(duty, fan, air):
    memory = ThermalMemory()
    for minute in range(600):
        moment = Observation(60.0, air + 0.02 * minute * (not duty), 20.0, duty, fan, 0.0)
        memory, found = look(memory, moment, unknown_box(250.0, "exhaust"))
        assert found == ()


def test_a_fan_that_only_stirs_is_never_called_blocked(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text(
        "geometry: {volume_m3: 0.05, heater_max_w: 40.0}\nfan_role: stirring\n"
        "effects: {wall_loss: {UA: 2.0}, extra_capacity: {kC: 12.0}}\n"
    )
    assert not bounds_of(BoxSettings(str(path))).fan_cools


def test_a_fan_that_stirs_takes_no_heat_for_sure(tmp_path):
    file = fitted(tmp_path, "stirred_loss: {G_stir: 6.0}", role="stirring")
    assert box_bounds(file).fan_min_w_k == 0.0 and not box_bounds(file).fan_cools


def test_a_slow_sensor_does_not_make_a_box_heavy(tmp_path):
    plain, slow = (box_bounds(fitted(tmp_path, own)) for own in ("", "sensor_lag: {tau_s: 240.0}"))
    # The air that is not shown yet counts as stored: 2 W/K for 240 s are 480 J/K, times the margin.
    assert plain.capacity_max_j_k < slow.capacity_max_j_k < plain.capacity_max_j_k + 1.1 * 1.5 * 480.0
    assert slow.capacity_min_j_k < 12.0 * 0.05 * 1207.0  # all that is warmed


def test_a_heater_under_the_soil_does_not_make_a_box_heavy(tmp_path):
    """The box holds 720 J/K of air and cover, warmed through an element of an hour."""
    found = box_bounds(fitted(tmp_path, "heater_lag: {tau_h: 3600.0}"))
    assert 720.0 < found.capacity_max_j_k < 100_000.0


def test_a_mass_that_two_hours_do_not_warm_keeps_the_settled_loss_out_of_the_bounds(tmp_path):
    """Soil behind 8 W/K that takes a day: 10 W/K at first, 2 W/K in the end; two hours see the first."""
    file = fitted(tmp_path, "soil_mass: {C_s: 1000000.0, G_s: 8.0}")
    found = box_bounds(file)
    assert found.loss_min_w_k < 10.0 < found.loss_max_w_k
    assert found.loss_max_w_k < 20.0


def test_bounds_fresh_from_two_hours_of_tests_claim_less_loss(tmp_path):
    file = fitted(tmp_path, "")
    fresh = replace(file, provenance={"command": "greenhouse commission"})
    assert box_bounds(fresh).loss_min_w_k < 0.7 * box_bounds(file).loss_min_w_k
    assert box_bounds(fresh).loss_max_w_k == box_bounds(file).loss_max_w_k


@pytest.mark.parametrize("fan", [0.0, 1.0])
@pytest.mark.parametrize(
    "effect",
    ["", "soil_mass: {C_s: 60000.0, G_s: 6.0}", "heater_lag: {tau_h: 1800.0}", "sensor_lag: {tau_s: 200.0}"],
)
def test_a_healthy_box_that_cools_from_a_long_hold_is_not_blamed(tmp_path, effect, fan):
    file = fitted(tmp_path, effect)
    bounds, twin = box_bounds(file), file.twin()
    steps = np.zeros((1, 600))
    air = twin.rollout(
        at_rest(twin, 38.0, 20.0), steps, steps + fan, 20.0, before=Commands(steps + 0.9, steps)
    )[0]
    memory, _ = look(ThermalMemory(), Observation(60.0, 38.0, 20.0, 0.9, False, 0.0), bounds)
    for value in air.tolist():
        memory, found = look(memory, Observation(60.0, value, 20.0, 0.0, fan > 0.0, 0.0), bounds)
        assert found == ()


@pytest.mark.parametrize("effect", ["", "soil_mass: {C_s: 60000.0, G_s: 1.0}", "sensor_lag: {tau_s: 200.0}"])
def test_a_relay_that_sticks_while_the_rig_is_off_is_still_named(tmp_path, effect):
    file = fitted(tmp_path, effect)
    bounds, twin = box_bounds(file), file.twin()
    steps = np.ones((1, 120))
    air = twin.rollout(at_rest(twin, 20.0, 20.0), steps, 0.0 * steps, 20.0)[0]
    memory, named = ThermalMemory(), []
    for minute, value in enumerate(air.tolist(), 1):
        memory, found = look(memory, Observation(60.0, value, 20.0, 0.0, False, 0.0), bounds)
        named += [(minute, fault.trip) for fault in found]
    assert named and named[0][1] == "heater_stuck_on" and named[0][0] <= 61


def fitted(folder: Path, effects: str, role: str = "exhaust") -> TwinFile:
    """Return a box of 50 litres and 40 W whose walls lose 2 W/K, with one more effect."""
    path = folder / "fitted.yaml"
    path.write_text(
        "geometry: {volume_m3: 0.05, heater_max_w: 40.0, fan_max_m3_s: 0.004}\n"
        f"fan_role: {role}\n"
        f"effects: {{wall_loss: {{UA: 2.0}}, extra_capacity: {{kC: 12.0}}, {effects}}}\n"
    )
    return read_twin_file(path)


def test_a_store_too_small_for_long_steps_has_bounds_too(tmp_path):
    small, larger = (box_bounds(fitted(tmp_path, f"soil_mass: {{C_s: {c}, G_s: 0.5}}")) for c in (90, 120))
    assert small.loss_min_w_k == pytest.approx(larger.loss_min_w_k, rel=0.01)


def test_a_heater_slower_than_any_that_is_looked_at_in_short_steps_has_bounds_too(tmp_path):
    slow, slower = (box_bounds(fitted(tmp_path, f"heater_lag: {{tau_h: {s}}}")) for s in (7190, 7210))
    assert slow.element_lag_s == pytest.approx(slower.element_lag_s, rel=0.01)


def test_a_box_recorded_in_steps_of_ten_minutes_may_be_slower_than_others(tmp_path):
    file = fitted(tmp_path, "heater_lag: {tau_h: 7000.0}")
    slow = {"heater_lag": {"tau_h": replace(file.effects["heater_lag"]["tau_h"], value=100_000.0)}}
    assert box_bounds(replace(file, sample_s=600.0, effects={**file.effects, **slow})).element_lag_s > 1e5


def test_a_light_box_with_a_strong_fan_may_cool_faster(tmp_path):
    path = tmp_path / "light.yaml"
    path.write_text(
        "geometry: {volume_m3: 0.03, heater_max_w: 40.0, fan_max_m3_s: 0.03}\n"
        "effects: {wall_loss: {UA: 1.0}, extra_capacity: {kC: 3.0}, sensor_lag: {tau_s: 10.0}}\n"
    )
    # 109 J/K, 20 K over the room: 36 W/K take 6.6 K/s of the air, and the sensor shows a seventh after 5 s
    assert box_bounds(read_twin_file(path)).air_rate_max_k_s == pytest.approx(1.4, abs=0.1)
    heavy = box_bounds(fitted(tmp_path, "soil_mass: {C_s: 900, G_s: 0.5}, sensor_lag: {tau_s: 300.0}"))
    assert heavy.air_rate_max_k_s == PAPER_BOX.air_rate_max_k_s


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"box.twin: .*missing.yaml"):
        bounds_of(BoxSettings(str(tmp_path / "missing.yaml")))


def test_bounds_are_plain_numbers():
    found = bounds_of(BoxSettings(str(DIAGNOSED)))
    json.dumps({item.name: getattr(found, item.name) for item in fields(found)})
