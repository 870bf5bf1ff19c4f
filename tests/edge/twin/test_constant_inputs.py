"""The twin under inputs that stay, beside its own rollout."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.twin.constant_inputs import ConstantInputs, SteadyTwin
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import at_rest

ROOM_C = 21.0
HOURS, BENT_HOURS = 50, 5  # bent heat takes ten times as long to roll out; no body is slow beside it
WALL = {"wall_loss": {"UA": 4.0}}
SLOW = {
    "wall_mass": {"C_w": 9000.0, "G_in": 8.0, "G_out": 8.0},
    "heater_lag": {"tau_h": 300.0},
    "imperfect_mixing": {"F_mix": 0.01},
    "sensor_lag": {"tau_s": 40.0},
    "constant_heat": {"P0": 3.0},
    "sensor_bias": {"bias": 0.4},
    "ambient_offset": {"b_amb": 0.3},
}
DELAYS = WALL | {
    "heater_deadtime": {"d_h": 45.0},
    "heater_sag": {"sag": 0.1},
    "heater_saturation": {"u_sat": 0.8},
}
BENT = WALL | {"longwave_radiation": {"epsA": 0.2}, "natural_convection": {"G_nc": 1.0}}
TWINS = {"wall": WALL, "slow": SLOW, "delays": DELAYS, "bent": BENT}
FILES = ("edge/models/default_bundle/twin.yaml", "training/results/paper_case/interpolation/twin.yaml")


def twins() -> list[object]:
    made = [pytest.param(BoxTwin(effects=effects), id=name) for name, effects in TWINS.items()]
    return made + [pytest.param(read_twin_file(Path(path)).twin(), id=path) for path in FILES]


def rolled(twin: BoxTwin, begin: np.ndarray, duty: float, fan: float) -> np.ndarray:
    """Air at the begin and after each step of two days, or of some hours where heat bends."""
    steps = round(3600.0 * (BENT_HOURS if twin.signals.bends else HOURS) / twin.step_s)
    inputs = Commands(np.full((1, steps), duty), np.full((1, steps), fan))
    still = Commands(np.zeros((1, 5)), np.zeros((1, 5)))
    air = twin.rollout(begin, *inputs, ROOM_C, before=still)[0]
    return np.concatenate([[begin[0]], air])


@pytest.mark.parametrize("twin", twins())
@pytest.mark.parametrize(("duty", "fan"), [(1.0, 0.0), (0.4, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_the_final_air_is_that_of_a_long_rollout(twin: BoxTwin, duty: float, fan: float) -> None:
    final_c = SteadyTwin(twin, ConstantInputs(ROOM_C, fan)).final_c(duty)
    assert final_c == pytest.approx(rolled(twin, at_rest(twin, ROOM_C, ROOM_C), duty, fan)[-1], abs=2e-3)


@pytest.mark.parametrize("twin", twins())
def test_the_heat_that_holds_a_temperature_ends_there(twin: BoxTwin) -> None:
    steady = SteadyTwin(twin, ConstantInputs(ROOM_C))
    share = steady.share_to_hold(29.0)
    duty = next(one for one in np.linspace(0.0, 1.0, 100_001) if twin.signals.duty(np.array(one)) >= share)
    assert steady.final_c(float(duty)) == pytest.approx(29.0, abs=1e-3)


@pytest.mark.parametrize("twin", twins())
def test_the_time_to_a_target_is_that_of_a_rollout(twin: BoxTwin) -> None:
    quick = replace(twin, step_s=10.0)
    steady = SteadyTwin(quick, ConstantInputs(ROOM_C))
    begin = steady.rest_at(ROOM_C)
    course = rolled(quick, begin, 1.0, 0.0)
    row = int(np.argmax(course >= 30.0))
    share = (30.0 - course[row - 1]) / (course[row] - course[row - 1])
    time_s = steady.time_s(begin, 30.0, 1.0, quick.signals.heater_dead_s)
    # A secant stands for bent heat on the way: 2 % of the time; else the resolution and the rollout's steps.
    assert time_s == pytest.approx(
        10.0 * (row - 1 + share), rel=0.02 if quick.signals.bends else 0.002, abs=2.0
    )


def test_a_box_that_cools_is_timed_as_well() -> None:
    twin = BoxTwin(effects=WALL, step_s=1.0)
    blown = SteadyTwin(twin, ConstantInputs(ROOM_C, 1.0))
    course = rolled(replace(twin, step_s=1.0), np.array([31.0]), 0.0, 1.0)
    half_s = int(np.argmax(course <= 26.0))
    assert blown.time_s(np.array([31.0]), 26.0, 0.0) == pytest.approx(half_s, abs=1.5)


def test_a_target_above_the_final_air_is_never_reached() -> None:
    steady = SteadyTwin(BoxTwin(effects=WALL), ConstantInputs(ROOM_C))
    final_c = steady.final_c(1.0)  # 100 W over 4 W/K
    assert final_c == pytest.approx(ROOM_C + 25.0)
    begin = steady.rest_at(ROOM_C)
    assert steady.time_s(begin, final_c + 0.01, 1.0) == math.inf
    assert steady.time_s(begin, final_c - 0.01, 1.0) < 3600.0
    assert steady.time_s(begin, ROOM_C, 1.0) == 0.0


def test_a_box_that_loses_nothing_has_no_final_air() -> None:
    steady = SteadyTwin(BoxTwin(), ConstantInputs(ROOM_C))
    assert steady.final_c(1.0) == math.inf
    assert steady.final_c(0.0) == ROOM_C
    cooled = ConstantInputs(ROOM_C, more_w=lambda temp_c: -5.0)
    assert SteadyTwin(BoxTwin(), cooled).final_c(0.0) == -math.inf


def test_a_heater_without_heat_is_refused() -> None:
    cold = BoxTwin(effects=WALL | {"heater_efficiency": {"eta": 0.0}})
    with pytest.raises(DataError, match="does not warm the air"):
        SteadyTwin(cold, ConstantInputs(ROOM_C)).final_c(1.0)


def test_air_that_heat_in_a_cool_box_warms_settles_where_it_first_can() -> None:
    """A step of 30 W at 25 °C: 5 W hold 21 + 1.25 K, and with 30 W more the box stands at the step."""
    step = {"unnamed_heat": {"P_x": 30.0, "T_x": 25.0, "w_x": 0.2}}
    steady = SteadyTwin(BoxTwin(effects=WALL | step), ConstantInputs(ROOM_C))
    for duty in (0.0, 0.05, 0.5, 1.0):
        final_c = steady.final_c(duty)
        assert steady.share_to_hold(final_c) == pytest.approx(duty, abs=1e-4)
    assert 24.0 < steady.final_c(0.05) < 26.0
    assert steady.final_c(1.0) == pytest.approx(ROOM_C + 25.0, abs=1e-3)
    cold = {"unnamed_heat": {"P_x": -60.0, "T_x": 25.0, "w_x": 0.2}}  # less heat holds 26 °C than 24 °C
    bent = SteadyTwin(BoxTwin(effects=WALL | cold), ConstantInputs(ROOM_C))
    assert bent.share_to_hold(26.0) < bent.share_to_hold(24.0)
    assert bent.final_c(1.0) == pytest.approx(ROOM_C + 25.0, abs=1e-3)


def test_further_heat_counts_on_the_way_and_at_its_end() -> None:
    """A loss that grows by 2 W/K is a wall of 6 W/K."""
    wall = SteadyTwin(BoxTwin(effects={"wall_loss": {"UA": 6.0}}), ConstantInputs(ROOM_C))
    more = ConstantInputs(ROOM_C, more_w=lambda temp_c: -2.0 * (temp_c - ROOM_C))
    same = SteadyTwin(BoxTwin(effects=WALL), more)
    begin = wall.rest_at(ROOM_C)
    assert same.final_c(1.0) == pytest.approx(wall.final_c(1.0))
    assert same.share_to_hold(29.0) == pytest.approx(wall.share_to_hold(29.0))
    assert same.time_s(begin, 29.0, 1.0) == pytest.approx(wall.time_s(begin, 29.0, 1.0), abs=1.0)


def test_a_body_that_loses_ends_as_a_path_to_the_room_and_begins_as_a_store() -> None:
    body = BoxTwin(effects=WALL | {"soil_mass": {"C_s": 20_000.0, "G_s": 3.0}})
    kept, lost = (SteadyTwin(body, ConstantInputs(ROOM_C, seen_s=1.0, lost=share)) for share in (0.0, 0.5))
    begin = kept.rest_at(ROOM_C)
    assert kept.final_c(1.0) == pytest.approx(ROOM_C + 25.0)
    assert lost.final_c(1.0) == pytest.approx(ROOM_C + 100.0 / 5.5, rel=1e-4)
    assert lost.time_s(begin, 30.0, 1.0) == pytest.approx(kept.time_s(begin, 30.0, 1.0), rel=0.02)
    # A fit over 10 time constants would have shown it.
    known = SteadyTwin(body, ConstantInputs(ROOM_C, lost=0.5, seen_s=10.0 * 20_000.0 / 3.0))
    assert known.final_c(1.0) == pytest.approx(ROOM_C + 25.0, abs=1e-3)


def test_losses_may_be_heat_into_a_body_that_was_not_seen() -> None:
    """Half of 4 W/K begins as a loss and ends as none, through a wall that stores and without one alike."""
    for name, effects in {"wall": WALL, "slow": SLOW}.items():
        usual, stored = (
            SteadyTwin(BoxTwin(effects=effects), ConstantInputs(ROOM_C, seen_s=7200.0, stored=share))
            for share in (0.0, 0.5)
        )
        # In SLOW the inner film of 8 W/K stays, and of the outer one 4 are left: 2.67 W/K in place of 4, and
        # the heater's half of the air leads by as much as before.
        times = {"wall": 2.0, "slow": 1.5}[name]
        rises = [steady.final_c(1.0) - steady.final_c(0.0) for steady in (usual, stored)]
        assert rises[1] == pytest.approx(times * rises[0], rel=0.03)
        ways = [steady.time_s(steady.rest_at(ROOM_C + 1.0), 30.0, 1.0) for steady in (usual, stored)]
        assert ways[1] == pytest.approx(ways[0], rel=0.1)


def test_another_heater_has_its_share_of_a_cut() -> None:
    cut = WALL | {"unnamed_cut": {"f_x": 0.2, "T_x": 10.0, "w_x": 0.5}}
    steady = SteadyTwin(BoxTwin(effects=cut), ConstantInputs(ROOM_C, power=1.5))
    assert steady.final_c(1.0) == pytest.approx(ROOM_C + 150.0 * 0.8 / 4.0)
    assert steady.share_to_hold(ROOM_C + 15.0) == pytest.approx(0.5)


def test_a_duty_makes_up_for_a_heater_that_sags() -> None:
    steady = SteadyTwin(BoxTwin(effects=DELAYS), ConstantInputs(ROOM_C))
    for duty in (0.1, 0.5, 0.79):
        assert steady.duty_to_hold(steady.final_c(duty)) == pytest.approx(duty, abs=1e-4)
    assert steady.duty_to_hold(ROOM_C - 2.0) == pytest.approx(-0.08)
    assert steady.duty_to_hold(steady.final_c(1.0) + 0.1) > 1.0


def test_a_missing_column_is_named_with_its_effect() -> None:
    twin = BoxTwin(effects=WALL | {"led_gain": {"P_led": 10.0}})
    with pytest.raises(DataError, match=r"light: missing, the twin's led_gain needs it"):
        SteadyTwin(twin, ConstantInputs(ROOM_C))
    lit = SteadyTwin(twin, ConstantInputs(ROOM_C, columns={"light": 1.0}))
    assert lit.final_c(0.0) == pytest.approx(ROOM_C + 2.5)  # 10 W over 4 W/K


def test_walls_age_until_the_day_that_is_asked_for() -> None:
    twin = BoxTwin(effects=WALL | {"ua_drift": {"ua_drift": 0.1}}, day0_utc=0.0)
    aged = SteadyTwin(twin, ConstantInputs(ROOM_C, columns={"utc": 2.5 * 86400.0}))
    assert aged.final_c(1.0) == pytest.approx(ROOM_C + 20.0)  # 100 W over 4 W/K times 1.25
