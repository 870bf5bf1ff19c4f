"""A fan that runs for a share of each step, and the exponentials at many speeds."""

import numpy as np
import pytest
from rk45 import rk45_rollout

from edge.drift.kalman import Filter
from edge.formats.run_file import RecordedRun, resample
from edge.twin.discretisation import MANY, exponential, exponentials
from edge.twin.fit import free_run, rmse
from edge.twin.linearise import EnsembleRun, linearise, responses
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands, fan_in_parts
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.warm_start import PastColumns, at_rest, state_now

ROOM_C, PART_S, PARTS = 21.0, 5.0, 12
BODIES = {
    "wall_mass": {"C_w": 5000.0, "G_in": 12.0, "G_out": 7.0},
    "extra_capacity": {"kC": 4.0},
    "heater_lag": {"tau_h": 300.0},
}
LINEAR = {
    "bare": {},
    "loss": {"wall_loss": {"UA": 5.0}},
    "bodies": BODIES,
    "fan's heat": {**BODIES, "fan_heat": {"P_fan": 4.0}},
    "late heater": {**BODIES, "heater_deadtime": {"d_h": 25.0}},
    "late fan": {**BODIES, "fan_deadtime": {"d_f": 10.0}},
    "later fan": {**BODIES, "fan_deadtime": {"d_f": 85.0}},
    "slow fan": {**BODIES, "fan_spinup": {"tau_f": 8.0}},
}
BENT = {"stack": {**BODIES, "stack_ventilation": {"F_st": 0.001}}}
SHARES = np.array([0, 1, 0, 3, 12, 6, 0, 12, 12, 4, 9, 0, 0, 1, 2, 6, 12, 3, 0, 0]) / PARTS
DUTY = np.repeat([0.6, 1.0, 0.2, 0.5], 5)
ROWS = len(SHARES)


def fine(columns):
    """Columns of steps of 60 s as those of 5 s."""
    return np.repeat(columns, PARTS)


RELAY = (np.arange(ROWS * PARTS) % PARTS < fine(SHARES) * PARTS - 0.5).astype(float)


def in_fine_steps(effects):
    """Return a twin in steps of 5 s, and its readings after each minute and before the first, [ROWS + 1]."""
    twin = BoxTwin(effects=effects, step_s=PART_S)
    air = twin.rollout(at_rest(twin, 27.0, ROOM_C), fine(DUTY)[None], RELAY[None], ROOM_C)[0]
    return np.concatenate([[27.0], air[PARTS - 1 :: PARTS]])


@pytest.mark.parametrize("effects", [*LINEAR.values(), *BENT.values()], ids=[*LINEAR, *BENT])
def test_a_share_is_the_fan_on_from_the_steps_beginning(effects):
    twin = BoxTwin(effects=effects)
    temps = twin.rollout(at_rest(twin, 27.0, ROOM_C), DUTY[None], SHARES[None], ROOM_C)[0]
    # What the relay did, in steps that it does not change in.
    np.testing.assert_allclose(temps, in_fine_steps(effects)[1:], atol=1e-3 if twin.signals.bends else 1e-4)


@pytest.mark.parametrize("effects", LINEAR.values(), ids=LINEAR)
def test_every_way_to_step_a_twin_has_the_same_share(effects):
    twin, start = BoxTwin(effects=effects), 27.0
    state = at_rest(twin, start, ROOM_C)
    temps = np.append(start, twin.rollout(state, DUTY[None], SHARES[None], ROOM_C)[0])
    room = np.full(ROWS, ROOM_C)
    steps = linearise(twin, RunBatch(temps[None], DUTY[None], SHARES[None], room[None]))
    linear = responses([EnsembleRun(steps, state[None], steps.driven)])[0, 0]
    np.testing.assert_allclose(linear, temps[1:], atol=1e-9)
    # A filter that starts at rest and is shown what the twin expects has nothing to correct.
    own = Filter(twin)
    columns = {
        "time_s": 60.0 * np.arange(ROWS + 1),
        "temp_air_measured": temps,
        "temp_ambient": np.full(ROWS + 1, ROOM_C),
        "heater_duty": np.append(DUTY, np.nan),
        "fan_on": np.append(SHARES, np.nan),
    }
    now = own.begin({name: column[:1] for name, column in columns.items()})
    for rows in range(2, ROWS + 2):
        now, innovation = own.step(now, {name: column[:rows] for name, column in columns.items()})
        assert abs(innovation.value_k) < 1e-8
    past = PastColumns(temps, columns["temp_ambient"], columns["heater_duty"], columns["fan_on"])
    np.testing.assert_allclose(state_now(twin, past), now.mean, atol=1e-8)


def test_one_step_ahead_is_the_same_as_a_rollout_of_one():
    twin = BoxTwin(effects=BODIES)
    state = at_rest(twin, 27.0, ROOM_C)
    ahead = twin.advance(state, ROOM_C, 0.6, np.array([0.25, 1.0, 0.0]))[:, 0]
    for fan, temp in zip([0.25, 1.0, 0.0], ahead, strict=True):
        assert temp == pytest.approx(twin.rollout(state, np.array([[0.6]]), np.array([[fan]]), ROOM_C)[0, 0])


@pytest.mark.parametrize("control", ["relay", "speed"])
def test_the_reference_solution_has_the_same_meaning(control):
    twin = BoxTwin(effects=BODIES, fan_control=control)
    state = at_rest(twin, 27.0, ROOM_C)
    exact = twin.rollout(state, DUTY[None], SHARES[None], ROOM_C)[0]
    room = np.full(ROWS, ROOM_C)
    other = rk45_rollout(twin, state, DUTY, SHARES, room, rtol=1e-10, atol=1e-10)[:, 0]
    np.testing.assert_allclose(exact, other, atol=1e-6)


def test_a_share_that_ends_within_5_s_is_a_mean_there():
    # 7 s: the first 5 s whole, 2 s of the next; 0 and 1 are what they were
    begins = PART_S * np.arange(PARTS)
    on = fan_in_parts(np.array([7.0 / 60.0, 0.0, 1.0, np.nan])[:, None], begins, PART_S, 60.0)
    assert on[0].tolist() == [1.0, 0.4, *[0.0] * 10]
    assert on[1].tobytes() == np.zeros(PARTS).tobytes() and on[2].tolist() == [1.0] * PARTS
    assert np.isnan(on[3]).all()


@pytest.mark.parametrize("step_s", [1.0, 5.0])
def test_in_steps_of_5_s_and_less_a_share_and_a_speed_are_the_same(step_s):
    relay, speed = (BoxTwin(effects=BODIES, step_s=step_s, fan_control=name) for name in ("relay", "speed"))
    state, shares = at_rest(relay, 27.0, ROOM_C), np.linspace(0.0, 1.0, 21)[None]
    temps = [twin.rollout(state, np.full_like(shares, 0.4), shares, ROOM_C) for twin in (relay, speed)]
    np.testing.assert_allclose(*temps, atol=1e-6)


@pytest.mark.parametrize("effects", [*LINEAR.values(), *BENT.values()], ids=[*LINEAR, *BENT])
def test_a_fan_that_is_off_or_on_does_not_depend_on_how_it_is_driven(effects):
    relay, speed = (BoxTwin(effects=effects, fan_control=name) for name in ("relay", "speed"))
    state, fan = at_rest(relay, 27.0, ROOM_C), np.round(SHARES)[None]
    temps = [twin.rollout(state, DUTY[None], fan, ROOM_C) for twin in (relay, speed)]
    np.testing.assert_array_equal(*temps)


def test_commands_before_the_start_are_shares_too():
    twin = BoxTwin(effects=LINEAR["later fan"])
    state, still = at_rest(twin, 27.0, ROOM_C), np.zeros((1, 3))
    temps = [
        twin.rollout(state, still, still, ROOM_C, before=Commands(np.zeros(2), np.array([0.0, share])))[0]
        for share in (0.5, 1.0)
    ]
    # 85 s late: what the fan does in the minute before the start begins 25 s after it.
    assert temps[0][0] > temps[1][0] + 0.01


@pytest.mark.parametrize("effects", LINEAR.values(), ids=LINEAR)
def test_a_run_of_parts_is_no_error_of_its_own_twin(effects):
    """A run at 5 s, brought to 60 s: before, the twin took the share for a speed throughout the step."""
    twin = BoxTwin(effects=effects, step_s=PART_S)
    state = at_rest(twin, 27.0, ROOM_C)
    air = twin.rollout(state, fine(DUTY)[None], RELAY[None], ROOM_C)[0]
    columns = {
        "time_s": PART_S * np.arange(len(air) + 1),
        "temp_air_c": np.append(27.0, air),
        "temp_ambient_c": np.full(len(air) + 1, ROOM_C),
        "heater_duty": np.append(fine(DUTY), 0.0),
        "fan_on": np.append(RELAY, 0.0),
    }
    runs = batch_runs([resample(RecordedRun(columns), 60.0)], 60.0)
    np.testing.assert_allclose(runs.fan[0], SHARES, atol=1e-9)
    relay, speed = (BoxTwin(effects=effects, fan_control=name) for name in ("relay", "speed"))
    errors_k = [rmse(free_run(one, runs, runs.ambient, 0.1)) for one in (relay, speed)]
    assert errors_k[0] < 0.01 < 0.1 < errors_k[1]


# what is interpolated is what each exponential is


LENGTHS = np.array([5.0, 5.0, 2.5, 1e-3])
AIR_1_S = np.array([[-1.0, 0.0], [0.0, 0.0]])  # the fan at full speed changes the air within a second


@pytest.mark.parametrize("kinds", [1, 3])
@pytest.mark.parametrize("speeds", [1, MANY // 4, MANY])
def test_many_speeds_are_stepped_as_each_alone(kinds: int, speeds: int) -> None:
    draw = np.random.default_rng(speeds)
    rates = np.repeat(draw.random((kinds, 2, 2)) * [[-0.05, 0.05], [0.01, -0.01]], speeds, axis=0)
    fan = np.clip(draw.uniform(-0.1, 1.1, (len(LENGTHS), len(rates))), 0.0, 1.0)
    state, integral = exponentials(rates, AIR_1_S, fan, LENGTHS)
    for j, length in enumerate(LENGTHS):
        for s in range(0, len(rates), 17):
            alone = exponential(rates[s : s + 1] + fan[j, s] * AIR_1_S, length)
            np.testing.assert_allclose(state[j, s], alone[0][0], atol=1e-13)
            np.testing.assert_allclose(integral[j, s], alone[1][0], atol=1e-12)
