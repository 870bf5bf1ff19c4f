"""A limit for plans over 20 min: the beam of MPC-Twin over the box's own equations and true state.

Horizon, fan, limits and knowledge of the reference are those of `MPC-Twin-P`, but no twin, filter or noise
comes between: its step is the tangent of the box at its present state, its sun and its mains, with the
board's pulses. A box bends, so a plan along the tangent takes full heat for more than it comes to in a large
step; a twin that was fitted to such steps may plan one better.
"""

import numpy as np
from numpy.typing import NDArray

from bench.boxes.box import Box
from bench.boxes.pulses import relay_share
from edge.controllers.mpc_twin import Belief, MpcTwin, fan_shares
from edge.controllers.twin_plan.linear_step import LinearStep, look_marks
from edge.core.controller import Context
from edge.core.names import HEATER_LEVELS
from edge.models.pbm import Pbm

Floats = NDArray[np.float64]
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
