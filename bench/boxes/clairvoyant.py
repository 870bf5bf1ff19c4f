"""A limit for plans over 20 min: the beam of MPC-Twin over the box's own equations and true state.

Horizon, fan, limits and knowledge of the reference are those of `MPC-Twin-P`, but no twin, filter or noise
comes between: its step is the tangent of the box at its present state, its sun and its mains, with the
board's pulses. A box bends, so a plan along the tangent takes full heat for more than it comes to in a large
step; a twin that was fitted to such steps may plan one better.
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.boxes.box import Box
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.mpc_twin import Belief, MpcTwin, fan_shares
from edge.controllers.pid import FAN_OFF_K, FILTER, ROUNDING, Pid, tracking_s
from edge.controllers.twin_plan.linear_step import LinearStep, linear_step, look_marks
from edge.core.controller import Context
from edge.core.names import HEATER_LEVELS
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.warm_start import at_rest
from firmware_protocol.virtual_board.board_config import BoardConfig

Floats = NDArray[np.float64]

WINDOW_S = BoardConfig().pwm_window_s


def relay_share(duty: float | Floats, time_s: float, dt_s: float) -> Floats:
    """Return the share of dt_s from time_s, both of the board's clock, for which the relay is closed.

    dt_s : within one window
    """
    return np.asarray(np.clip((duty * WINDOW_S - time_s % WINDOW_S) / dt_s, 0.0, 1.0))


PART_S = 1.0  # in which the fan is on or off; a slot of the heater's window
BY_K, BY_DUTY = 0.05, 0.25  # of each state, and of the duty, for the slope


class Clairvoyant(MpcTwin):
    """Plans over `box`. pbm : serves the report alone"""

    def __init__(self, box: Box, pbm: Pbm, weight: float, preview: bool, early_k: float) -> None:
        super().__init__("clairvoyant", pbm, weight, preview, early_k)
        self._box = box

    def _follow(self, context: Context) -> tuple[Belief, LinearStep]:
        box = self._box
        fans = fan_shares(context.step_s, context.limits) if box.facts.fan != "none" else (0.0,)
        step = tangent(box, context.step_s, fans, context.last_sent.heater_duty)
        state = np.append(box.physics.reading_c(box.state), box.state[0])
        return Belief(context.now_s, state, 0.0, np.zeros((len(state) + 1, len(state) + 1))), step


def tangent(box: Box, step_s: float, fans: tuple[float, ...], duty_now: float) -> LinearStep:
    """Return the step of a box from its present state and duty; state 0 is what its sensor would show."""
    physics, size, parts = box.physics, box.physics.size, round(step_s / PART_S)
    rows = size + 2  # as it is, each state, the duty
    states = np.repeat(box.state, len(fans) * rows, axis=0)
    duty = np.full(len(states), duty_now)
    by = BY_DUTY if duty_now <= 0.5 else -BY_DUTY
    for first in range(0, len(states), rows):
        states[first + 1 + np.arange(size), np.arange(size)] += BY_K
        duty[first + size + 1] += by
    marks, seen = look_marks(parts), []
    runs = np.repeat(np.array(fans), rows)
    for part in range(parts):
        on = (runs > (part + 0.5) / parts).astype(np.float64)
        time_s = box.time_s + part * PART_S
        states = physics.step(states, time_s, PART_S, relay_share(duty, time_s, PART_S), on)
        if part + 1 in marks:
            seen.append(physics.reading_c(states))
    after = np.concatenate((physics.reading_c(states)[:, None], states), axis=1)
    after = after.reshape(len(fans), rows, size + 1)
    within = np.array(seen).reshape(len(seen), len(fans), rows).transpose(1, 0, 2)
    return _as_step(box.state[0], after, within, fans, duty_now, by)


def _as_step(
    state: Floats, after: Floats, within: Floats, fans: tuple[float, ...], duty_now: float, by: float
) -> LinearStep:
    """after : [F, rows, n + 1]; within : [F, P, rows]; by : what the last row has more of the duty"""
    size = len(state)
    matrix = np.zeros((len(fans), size + 1, size + 1))
    matrix[:, :, 1:] = np.swapaxes(after[:, 1 : size + 1] - after[:, :1], 1, 2) / BY_K
    now = (after[:, -1] - after[:, 0]) / by
    slopes = (within[..., 1 : size + 1] - within[..., :1]) / BY_K
    by_duty = (within[..., -1] - within[..., 0]) / by
    looks = np.zeros((*within.shape[:2], size + 6))
    looks[..., 1 : size + 1] = slopes
    looks[..., size + 1] = within[..., 0] - slopes @ state - by_duty * duty_now
    looks[..., size + 3] = by_duty
    none = np.zeros((2 * len(fans), size + 1))
    return LinearStep(  # twice: the fan before changes nothing
        matrix=np.tile(matrix, (2, 1, 1)),
        constant=np.tile(after[:, 0] - matrix[:, :, 1:] @ state - now * duty_now, (2, 1)),
        room=none,
        now=np.tile(now, (2, 1)),
        late=none,
        heat=none,
        share=np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS,
        fans=np.array(fans),
        within=np.tile(looks, (2, 1, 1)),
        air=0,
    )


STEP_S = 60.0
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of SIMC's gains
DERIVATIVES_S = (0.0, 30.0, 60.0, 120.0)  # of the proportional gain
FAN_ON_K = (0.5, 1.0, 2.0)
NO_FAN_K = 1e6
SETTLED_STEPS = 360


class Gains(NamedTuple):
    """As `Pid` takes them: [1/K], [1/(K s)], [s/K], [K]."""

    kp: float
    ki: float
    kd: float
    fan_on_k: float


def simc(twin: BoxTwin, room_c: float) -> Gains:
    """Return a PI by SIMC from the twin's step response: delay, slope, gain."""
    ones, zeros = np.ones((1, SETTLED_STEPS)), np.zeros((1, SETTLED_STEPS))
    rest = at_rest(twin, room_c, room_c)
    given = {name: np.zeros(SETTLED_STEPS) for name in twin.needs}
    heated, idle = (
        twin.rollout(rest, duty, zeros, room_c, conditions=given, before=Commands(zeros, zeros))
        for duty in (ones, zeros)
    )
    rise = (heated - idle)[0]
    gain_k = float(rise[-1])
    t1, t2 = (STEP_S * (1 + float(np.argmax(rise >= share * gain_k))) for share in (0.283, 0.632))
    tau_s = max(1.5 * (t2 - t1), STEP_S)  # a first order with delay (Sundaresan, Krishnaswamy 1978)
    delay_s = max(t2 - tau_s, 0.0) + STEP_S  # and half a step of hold, half of the mean's
    kp = tau_s / (gain_k * 2.0 * delay_s)
    return Gains(kp, kp / min(tau_s, 8.0 * delay_s), 0.0, FAN_ON_K[1])


def tune_pid(twin: BoxTwin, room_c: float, courses: list[Floats], cools: bool) -> Pid:
    """Return the PID that costs least. courses : references by step [°C]; cools : the fan does"""
    first = simc(twin, room_c)
    grid = itertools.product(FACTORS, FACTORS, DERIVATIVES_S, FAN_ON_K if cools else (NO_FAN_K,))
    gains = np.array([(first.kp * p, first.ki * i, first.kp * p * d_s, fan_k) for p, i, d_s, fan_k in grid])
    rest = at_rest(twin, room_c, room_c)
    given = {name: np.zeros(1) for name in twin.needs}
    step = linear_step(twin, rest, room_c, given)
    cost = np.sum([_cost(step, gains, rest, room_c, course) for course in courses], axis=0)
    return Pid(*(float(value) for value in gains[np.argmin(cost)]))


def _cost(step: LinearStep, gains: Floats, rest: Floats, room_c: float, course: Floats) -> Floats:
    """Return the paper's cost [M] over a course. gains : [M, 4], as `Gains`"""
    kp, ki, kd, fan_on_k = gains.T
    count = len(kp)
    state, cost = np.tile(rest, (count, 1)), np.zeros(count)
    integral, derivative, output, sent = np.zeros((4, count))
    filter_s = kd / (kp * FILTER)
    back = [min(STEP_S / tracking_s(*row), 1.0) for row in gains[:, :3].tolist()]
    before, fan = np.zeros(count), np.zeros(count, dtype=np.int64)
    shown = last = state[:, step.shown]
    for reference in course:
        error = reference - shown
        derivative = (filter_s * derivative - kd * (shown - last)) / (filter_s + STEP_S)
        cut = sent - output
        integral += ki * error * STEP_S + np.where(np.abs(cut) > ROUNDING, back * cut, 0.0)
        output = kp * error + integral + derivative
        level = np.rint(np.clip(output, 0.0, 1.0) * HEATER_LEVELS)
        sent = level / HEATER_LEVELS
        cool = (level == 0) & (-error > np.where(fan == 1, FAN_OFF_K, fan_on_k))
        mode = step.mode(fan, cool.astype(np.int64))
        duty = step.share[level.astype(np.int64)]
        state = np.einsum("mij,mj->mi", step.matrix[mode], state) + step.constant[mode]
        state += step.room[mode] * room_c + step.now[mode] * duty[:, None]
        state += step.late[mode] * before[:, None]
        fan, before, last = cool.astype(np.int64), duty, shown
        shown = state[:, step.shown]
        cost += TRACKING_WEIGHT * (shown - reference) ** 2 + sent**2 + fan
    return cost
