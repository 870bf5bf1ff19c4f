"""A PID for a box, tuned on the twin that its own step tests gave.

It begins with SIMC (Skogestad, J. Process Control 13, 2003); of gains around these, of derivatives and of
thresholds of the fan it takes what costs least on the twin over the tuning references, by the paper's cost.
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.pid import FAN_OFF_K, Pid
from edge.controllers.twin_plan.linear_step import LinearStep, linear_step
from edge.core.names import HEATER_LEVELS
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
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
    state, integral, cost = np.tile(rest, (count, 1)), np.zeros(count), np.zeros(count)
    before, fan = np.zeros(count), np.zeros(count, dtype=np.int64)
    shown = last = state[:, step.shown]
    for reference in course:
        error = reference - shown
        integral = np.clip(integral + ki * error * STEP_S, 0.0, 1.0)  # as simple_pid limits it
        wished = np.clip(kp * error + integral - kd * (shown - last) / STEP_S, 0.0, 1.0)
        level = np.rint(wished * HEATER_LEVELS)
        cool = (level == 0) & (-error > np.where(fan == 1, FAN_OFF_K, fan_on_k))
        mode = step.mode(fan, cool.astype(np.int64))
        duty = step.share[level.astype(np.int64)]
        state = np.einsum("mij,mj->mi", step.matrix[mode], state) + step.constant[mode]
        state += step.room[mode] * room_c + step.now[mode] * duty[:, None]
        state += step.late[mode] * before[:, None]
        fan, before, last = cool.astype(np.int64), duty, shown
        shown = state[:, step.shown]
        cost += TRACKING_WEIGHT * (shown - reference) ** 2 + (level / HEATER_LEVELS) ** 2 + fan
    return cost
