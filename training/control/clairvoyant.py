"""The best that is possible: a beam search on the chamber itself, its future and the reference's known.

Every node is a whole chamber. Its 21 duties are represented by three for each time that the fan may be on:
between them the state a minute later is a parabola in the duty (tests/training/control).
Steps of 5 s are taken in the search; the plan's cost is then worked out in the chamber's own, and run.

What a controller may know and do limits its clairvoyant too: `early_k` is how far the air may leave the
reference before a step of it, `clash_weight` the price of heat against the fan, and `held_plan` takes the
present reference for all that comes.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.mpc_twin import EARLY_WEIGHT, band_before_steps, fan_shares
from edge.core.controller import ControlLimits
from edge.core.names import HEATER_LEVELS
from firmware_protocol.virtual_board.board_config import PWM_SLOTS
from training.control.chamber_rows import BoxStates, ChamberRows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Target = Literal["true", "sensor"]  # the air's mean; what the air's sensor would show without noise and steps
FINE_S, COARSE_S = 1.0, 5.0  # the chamber's own step; the search's
PROBED = (0, HEATER_LEVELS // 2, HEATER_LEVELS)  # levels
WIDTH = 400  # nodes kept
KIND_K = 0.5  # nodes whose elements are closer than this are of one kind: a level held for a quarter minute
LEAST_WEIGHT = 1e-6  # of two plans that track alike the one that spends less
AHEAD_STEPS, AGAIN_STEPS = 20, 5  # of a plan for the present reference, and when it is made anew
_SHARES = np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceCourse:
    """The course to follow.

    reference : [N], after each step [degC]; begin_s : of the first step
    early_k : the air leaves the reference by no more before a step of it [K]
    whole : the fan is off or on for all of a step
    clash_weight : of duty times share of the fan, a step
    """

    reference: Floats
    begin_s: float
    step_s: float
    weight: float
    target: Target
    early_k: float = np.inf
    whole: bool = False
    clash_weight: float = 0.0

    @property
    def fans(self) -> Floats:
        """Shares of a step for which the fan can be on, from 0 to 1: those of MPC-Twin."""
        return np.array([0.0, 1.0] if self.whole else fan_shares(self.step_s, ControlLimits()))


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCommands:
    """Commands [N], fan as share of the step, and what they cost by the chamber's own steps."""

    levels: Ints
    fan: Floats
    cost: float


def best_plan(
    fresh: Callable[[], ChamberRows], course: ReferenceCourse, width: int = WIDTH, kind_k: float = KIND_K
) -> PlannedCommands:
    """Find the cheapest plan. fresh : the chamber anew, as its future can be asked but once"""
    chamber = fresh()
    boxes, level = _idle(chamber, course), np.zeros(1, dtype=np.int64)
    levels, fan = _search(chamber, boxes, level, course, width, kind_k)
    return PlannedCommands(levels, fan, plan_cost(fresh(), course, levels, fan))


def held_plan(
    fresh: Callable[[], ChamberRows], course: ReferenceCourse, width: int = WIDTH // 4
) -> PlannedCommands:
    """Find the plan of one that knows all but the coming reference, and takes the present one to stay."""
    chamber = fresh()
    boxes, before = _idle(chamber, course), np.zeros(1, dtype=np.int64)
    levels, fans = np.zeros(len(course.reference), dtype=np.int64), np.zeros(len(course.reference))
    made = -AGAIN_STEPS
    for k, now in enumerate(course.reference):
        begin_s = course.begin_s + k * course.step_s
        if k - made >= AGAIN_STEPS or now != course.reference[k - 1]:
            made, view = k, replace(course, reference=np.full(AHEAD_STEPS, now), begin_s=begin_s)
            ahead = _search(deepcopy(chamber), boxes, before, view, width, KIND_K)
        levels[k], fans[k] = ahead[0][k - made], ahead[1][k - made]
        boxes = _minute(chamber, boxes, begin_s, course.step_s, levels[k : k + 1], fans[k], before)
        before = levels[k : k + 1]
    return PlannedCommands(levels, fans, plan_cost(fresh(), course, levels, fans))


def _search(
    chamber: ChamberRows, boxes: BoxStates, level: Ints, course: ReferenceCourse, width: int, kind_k: float
) -> tuple[Ints, Floats]:
    """Return levels and fan [N] of the cheapest plan. boxes, level : one box, and its level until now"""
    cost, trace, fans = np.zeros(1), [], course.fans
    low, high = band_before_steps(course.reference, course.early_k, 0, 0.0)
    for k, reference in enumerate(course.reference):
        begin_s = course.begin_s + k * course.step_s
        probes = _probe(chamber, boxes, level, begin_s, course.step_s, fans)
        target = _interpolate(_target(chamber, probes, course), len(fans))
        element = _interpolate(probes.temps[0], len(fans))
        total = cost[:, None, None] + TRACKING_WEIGHT * (target - reference) ** 2
        total += EARLY_WEIGHT * np.maximum(np.maximum(target - high[k], low[k] - target), 0.0) ** 2
        total += max(course.weight, LEAST_WEIGHT) * (_SHARES**2 + fans[:, None])
        total += course.clash_weight * _SHARES * fans[:, None]
        kept = _cheapest(total, element, width, kind_k)
        parent, fan, level = np.unravel_index(kept, total.shape)
        trace.append((parent, fan, level))
        boxes, cost = _children(probes, parent, fan, level, len(fans)), total.ravel()[kept]
    levels, places = _trace_back(trace, int(np.argmin(cost)))
    return levels, fans[places]


def plan_cost(chamber: ChamberRows, course: ReferenceCourse, levels: Ints, fan: Floats) -> float:
    """Return the paper's cost of a plan by the chamber's own steps."""
    boxes, cost = _idle(chamber, course), 0.0
    before = np.append(0, levels[:-1])
    for k, reference in enumerate(course.reference):
        begin_s = course.begin_s + k * course.step_s
        asked, asked_before = levels[k : k + 1], before[k : k + 1]
        boxes = _minute(chamber, boxes, begin_s, course.step_s, asked, fan[k], asked_before)
        error = float(_target(chamber, boxes, course)[0]) - reference
        cost += TRACKING_WEIGHT * error**2
        cost += course.weight * float((levels[k] / HEATER_LEVELS) ** 2 + fan[k])
    return cost


def _minute(
    chamber: ChamberRows, box: BoxStates, begin_s: float, step_s: float, level: Ints, fan: float, before: Ints
) -> BoxStates:
    """One box a step later, by the chamber's own steps. level, before : [1], of this step and the last"""
    for second in range(round(step_s / FINE_S)):
        time_s = begin_s + second * FINE_S
        on = relay_share(time_s, FINE_S, level, before if second == 0 else None)
        box = chamber.step(box, time_s, FINE_S, on, np.array([float(second * FINE_S < fan * step_s)]))
    return box


def relay_share(time_s: float, length_s: float, levels: Ints, before: Ints | None = None) -> Floats:
    """Share of a stretch in which the heater's relay is closed, at each level: the board's slow PWM.

    before : levels until then, where the stretch begins with a new command; it comes when a slot has just
        begun, and the board takes less heat at once but more with the next slot only
    """
    slots = int(time_s) + np.arange(max(1, round(length_s)))
    closed = (slots % PWM_SLOTS)[:, None] < levels
    if before is not None:
        closed[0] &= slots[0] % PWM_SLOTS < before
    return np.asarray(closed.mean(axis=0))


def _idle(chamber: ChamberRows, course: ReferenceCourse) -> BoxStates:
    """One box until the first step."""
    boxes, off = chamber.start(1), np.zeros(1)
    for second in range(int(course.begin_s / FINE_S)):
        boxes = chamber.step(boxes, second * FINE_S, FINE_S, off, off)
    return boxes


def _probe(
    chamber: ChamberRows, boxes: BoxStates, before: Ints, begin_s: float, step_s: float, fans: Floats
) -> BoxStates:
    """[M * F * 3]: each box a step later, by fan and probed level. before : levels that led to the boxes"""
    count = len(boxes.fan)
    boxes = boxes.of(np.repeat(np.arange(count), len(fans) * len(PROBED)))
    runs_s = step_s * np.tile(np.repeat(fans, len(PROBED)), count)
    levels, before = np.tile(PROBED, len(fans) * count), np.repeat(before, len(fans) * len(PROBED))
    for part in range(round(step_s / COARSE_S)):
        time_s = begin_s + part * COARSE_S
        on = relay_share(time_s, COARSE_S, levels, before if part == 0 else None)
        boxes = chamber.step(boxes, time_s, COARSE_S, on, (part * COARSE_S < runs_s).astype(float))
    return boxes


def _target(chamber: ChamberRows, boxes: BoxStates, course: ReferenceCourse) -> Floats:
    return chamber.air(boxes) if course.target == "true" else chamber.reading(boxes)


def _interpolate(probes: Floats, fans: int) -> Floats:
    """[M * F * 3] at the probed levels as [M, F, 21] at all."""
    return probes.reshape(-1, fans, len(PROBED)) @ lagrange(_SHARES).T


def lagrange(share: Floats) -> Floats:
    """Weights of the values at duties 0, 1/2 and 1 in the parabola through them, [..., 3]."""
    return np.stack(
        [2.0 * (share - 0.5) * (share - 1.0), 4.0 * share * (1.0 - share), 2.0 * share * (share - 0.5)],
        axis=-1,
    )


def _cheapest(total: Floats, element: Floats, width: int, kind_k: float) -> Ints:
    """Places of the cheapest child of each kind (element and fan), the `width` cheapest of them."""
    kinds = np.rint(element / kind_k).astype(np.int64)
    kinds = 2 * (kinds - kinds.min())
    kinds[:, -1] += 1  # a fan that is on at the end makes another kind
    cheapest_last = np.argsort(-total, axis=None, kind="stable")
    best = np.full(int(kinds.max()) + 1, -1)
    best[kinds.ravel()[cheapest_last]] = cheapest_last  # of one kind the last, the cheapest, stays
    best = best[best >= 0]
    return np.asarray(best[np.argsort(total.ravel()[best], kind="stable")[:width]])


def _children(probes: BoxStates, parent: Ints, fan: Ints, level: Ints, fans: int) -> BoxStates:
    """Return the boxes of the chosen children, by the parabola through their three probes.

    parent, fan, level : places, of `fans` for the fan
    """
    weights = lagrange(level / HEATER_LEVELS)
    parts = []
    for field in fields(BoxStates):
        values = getattr(probes, field.name)
        values = values.reshape(*values.shape[:-1], -1, fans, len(PROBED))[..., parent, fan, :]
        parts.append((values * weights).sum(axis=-1))
    return BoxStates(*parts)


def _trace_back(trace: list[tuple[Ints, Ints, Ints]], node: int) -> tuple[Ints, Ints]:
    levels, fans = [], []
    for parent, fan, level in reversed(trace):
        levels.append(level[node])
        fans.append(fan[node])
        node = int(parent[node])
    return np.array(levels[::-1]), np.array(fans[::-1])
