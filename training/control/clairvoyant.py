"""The best that is possible: a beam search on the chamber itself, its future and the reference's known.

Every node is a whole chamber. Its 42 commands are stood for by six, three duties with the fan off and on:
between them the state a minute later is a parabola in the duty (tests/training/test_control_clairvoyant.py).
Steps of 5 s are taken in the search; the plan's cost is then worked out in the chamber's own, and run.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.names import HEATER_LEVELS
from firmware_protocol.virtual_board.board_config import PWM_SLOTS
from training.control.chamber_rows import BoxStates, ChamberRows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Target = Literal["true", "sensor"]  # the air's mean; what the air's sensor would show without noise and steps
FINE_S, COARSE_S = 1.0, 5.0  # the chamber's own step; the search's
PROBED = (0, HEATER_LEVELS // 2, HEATER_LEVELS)  # levels
WIDTH = 600  # nodes kept
KIND_K = 0.5  # nodes whose elements are closer than this are of one kind: a level held for a quarter minute
LEAST_WEIGHT = 1e-6  # of two plans that track alike the one that spends less
_SHARES = np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceCourse:
    """The course to follow. reference : [N], after each step [degC]; begin_s : of the first step"""

    reference: Floats
    begin_s: float
    step_s: float
    weight: float
    target: Target


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCommands:
    """Commands [N], and what they cost by the chamber's own steps."""

    levels: Ints
    fan: Ints
    cost: float


def best_plan(
    fresh: Callable[[], ChamberRows], course: ReferenceCourse, width: int = WIDTH, kind_k: float = KIND_K
) -> PlannedCommands:
    """Find the cheapest plan. fresh : the chamber anew, as its future can be asked but once"""
    chamber = fresh()
    boxes = _idle(chamber, course)
    cost, level, trace = np.zeros(1), np.zeros(1, dtype=np.int64), []
    for k, reference in enumerate(course.reference):
        begin_s = course.begin_s + k * course.step_s
        probes = _probe(chamber, boxes, level, begin_s, course.step_s)
        target = _interpolate(_target(chamber, probes, course).reshape(-1, 2, len(PROBED)))
        element = _interpolate(probes.temps[0].reshape(-1, 2, len(PROBED)))
        effort = _SHARES**2 + np.array([[0.0], [1.0]])
        total = cost[:, None, None] + TRACKING_WEIGHT * (target - reference) ** 2
        total += max(course.weight, LEAST_WEIGHT) * effort
        kept = _cheapest(total, element, width, kind_k)
        parent, fan, level = np.unravel_index(kept, total.shape)
        trace.append((parent, fan, level))
        boxes, cost = _children(probes, parent, fan, level), total.ravel()[kept]
    levels, fans = _trace_back(trace, int(np.argmin(cost)))
    return PlannedCommands(levels, fans, plan_cost(fresh(), course, levels, fans))


def plan_cost(chamber: ChamberRows, course: ReferenceCourse, levels: Ints, fan: Ints) -> float:
    """Return the paper's cost of a plan by the chamber's own steps."""
    boxes, cost = _idle(chamber, course), 0.0
    before = np.append(0, levels[:-1])
    for k, reference in enumerate(course.reference):
        begin_s = course.begin_s + k * course.step_s
        for second in range(round(course.step_s / FINE_S)):
            asked_before = before[k : k + 1] if second == 0 else None
            on = relay_share(begin_s + second * FINE_S, FINE_S, levels[k : k + 1], asked_before)
            boxes = chamber.step(boxes, begin_s + second * FINE_S, FINE_S, on, fan[k : k + 1].astype(float))
        error = float(_target(chamber, boxes, course)[0]) - reference
        cost += TRACKING_WEIGHT * error**2
        cost += course.weight * float((levels[k] / HEATER_LEVELS) ** 2 + fan[k])
    return cost


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


def _probe(chamber: ChamberRows, boxes: BoxStates, before: Ints, begin_s: float, step_s: float) -> BoxStates:
    """[M * 2 * 3]: each box a step later, by fan and probed level. before : levels that led to the boxes"""
    count = len(boxes.fan)
    boxes = boxes.of(np.repeat(np.arange(count), 2 * len(PROBED)))
    fan = np.tile(np.repeat([0.0, 1.0], len(PROBED)), count)
    levels, before = np.tile(PROBED, 2 * count), np.repeat(before, 2 * len(PROBED))
    for part in range(round(step_s / COARSE_S)):
        time_s = begin_s + part * COARSE_S
        on = relay_share(time_s, COARSE_S, levels, before if part == 0 else None)
        boxes = chamber.step(boxes, time_s, COARSE_S, on, fan)
    return boxes


def _target(chamber: ChamberRows, boxes: BoxStates, course: ReferenceCourse) -> Floats:
    return chamber.air(boxes) if course.target == "true" else chamber.reading(boxes)


def _interpolate(probes: Floats) -> Floats:
    """[M, 2, 3] at the probed levels as [M, 2, 21] at all."""
    return probes @ lagrange(_SHARES).T


def lagrange(share: Floats) -> Floats:
    """Weights of the values at duties 0, 1/2 and 1 in the parabola through them, [..., 3]."""
    return np.stack(
        [2.0 * (share - 0.5) * (share - 1.0), 4.0 * share * (1.0 - share), 2.0 * share * (share - 0.5)],
        axis=-1,
    )


def _cheapest(total: Floats, element: Floats, width: int, kind_k: float) -> Ints:
    """Places of the cheapest child of each kind (element and fan), the `width` cheapest of them."""
    kinds = np.rint(element / kind_k).astype(np.int64)
    kinds = 2 * (kinds - kinds.min()) + np.array([[[0], [1]]])
    cheapest_last = np.argsort(-total, axis=None, kind="stable")
    best = np.full(int(kinds.max()) + 1, -1)
    best[kinds.ravel()[cheapest_last]] = cheapest_last  # of one kind the last, the cheapest, stays
    best = best[best >= 0]
    return np.asarray(best[np.argsort(total.ravel()[best], kind="stable")[:width]])


def _children(probes: BoxStates, parent: Ints, fan: Ints, level: Ints) -> BoxStates:
    """Return the boxes of the chosen children, by the parabola through their three probes."""
    weights = lagrange(level / HEATER_LEVELS)
    parts = []
    for field in fields(BoxStates):
        values = getattr(probes, field.name)
        values = values.reshape(*values.shape[:-1], -1, 2, len(PROBED))[..., parent, fan, :]
        parts.append((values * weights).sum(axis=-1))
    return BoxStates(*parts)


def _trace_back(trace: list[tuple[Ints, Ints, Ints]], node: int) -> tuple[Ints, Ints]:
    levels, fans = [], []
    for parent, fan, level in reversed(trace):
        levels.append(level[node])
        fans.append(fan[node])
        node = int(parent[node])
    return np.array(levels[::-1]), np.array(fans[::-1])
