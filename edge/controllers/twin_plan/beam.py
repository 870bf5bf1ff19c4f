"""A beam over a twin's future: all commands from every kept node, then the cheapest of each kind of node.

Two nodes are of one kind when the fan stands alike and the air would come to nearly the same temperature by
itself: what a node has stored is what its future depends on. So a node that heats early for a step that is
still to come is kept beside a cheaper one that does not.

Where heat shows after many steps only, as in a heavy box with a mat under its floor, no node of a few steps
has gained by it, and the beam keeps those without. So the plans of constant heat, and of full heat for the
first steps, are put beside what it finds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import FanRules, Ints, Plan, PlanningProblem
from edge.controllers.twin_plan.linear_step import LinearStep
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]
STORED_STEPS = 4  # so long after a node the air tells what is stored in it
KIND_K = 0.02  # nodes whose air would then be closer than this are of one kind
REST_WEIGHT = 1e6  # of heat or fan where the plan is to rest: above all but the relay's own rules


@dataclass(frozen=True, slots=True, eq=False)
class PlanStart:
    """The start of a plan. state [n]; disturbance [K/step]; ambient [°C]; level before; fan 0 or 1 until now

    fan_starts : how often the fan may still be started
    """

    state: Floats
    disturbance: float
    ambient: float
    level: int
    fan: int
    fan_starts: int = 1000


@dataclass(frozen=True, slots=True, eq=False)
class BeamResult:
    """The best plan, its air as the sensor would show it [N], the best that begins otherwise, nodes made."""

    plan: Plan
    air: Floats
    runner_up: Plan | None
    nodes: int


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """M nodes after the same number of steps. state [M, n]; the others [M].

    fan : 0 or 1 at the end; place : in the step's `fans`; starts : of the fan that are left
    """

    state: Floats
    cost: Floats
    fan: Ints
    place: Ints
    level: Ints
    hold: Ints
    starts: Ints
    parent: Ints


@dataclass(frozen=True, slots=True, eq=False)
class _Children:
    """Children of M nodes by fan and level: cost, later air temperature [M, F, 21], state at level 0."""

    cost: Floats
    stored: Floats
    base: Floats
    mode: Ints
    hold: Ints
    starts: Ints


def search(step: LinearStep, goal: PlanningProblem, start: PlanStart, width: int) -> BeamResult:
    """Find the cheapest plan with a beam of `width` nodes; the same arguments give the same plan.

    goal : weights, reference, limits and relay rules, its tail too; its own forecast does not count
    """
    found = _descend(step, goal, start, 1, lambda children, k: _cheapest(children, width))
    levels = _plain_levels(goal.horizon, goal.heater_levels)
    plain = _descend(step, goal, start, len(levels), lambda children, k: _as_told(children, levels[:, k]))
    return plain if plain.plan.cost < found.plan.cost else found


def _descend(
    step: LinearStep,
    goal: PlanningProblem,
    start: PlanStart,
    count: int,
    choose: Callable[[_Children, int], Ints],
) -> BeamResult:
    """Go from `count` equal nodes to the horizon's end. choose : places of the children that are kept"""
    drift = step.constant + step.room * start.ambient + step.heat * start.disturbance
    each = np.zeros(count, dtype=np.int64)
    level = _Level(
        np.repeat(start.state[None], count, axis=0),
        np.zeros(count),
        each + start.fan,
        each,
        each + start.level,
        each + goal.fan_rules.hold,
        each + start.fan_starts,
        each,
    )
    trace, nodes, weights = [level], 0, _stored_weights(step)
    for k in range(goal.horizon):
        children = _children(step, goal, start, drift, level, weights, k)
        kept = choose(children, k)
        nodes += children.cost.size
        level = _next(step, children, kept)
        trace.append(level)
    total = level.cost + _tail_cost(step, goal, drift, level)
    return _result(step, trace, total, nodes)


def _plain_levels(horizon: int, highest: int) -> Ints:
    """Return levels [P, N]: each one throughout, and the highest for the first 1 to N - 1 steps alone."""
    throughout = np.repeat(np.arange(highest + 1)[:, None], horizon, axis=1)
    first = np.where(np.arange(horizon) < np.arange(1, horizon)[:, None], highest, 0)
    return np.concatenate([throughout, first])


def _as_told(children: _Children, levels: Ints) -> Ints:
    """Places of the child of each node that has its level, the fan still where its relay may be open."""
    nodes = np.arange(len(levels))
    still = np.isfinite(children.cost[nodes, 0, levels])
    place = np.where(still, 0, children.cost.shape[1] - 1)
    return np.asarray(np.ravel_multi_index((nodes, place, levels), children.cost.shape))


def _stored_weights(step: LinearStep) -> Floats:
    """[n], by which a state says what its air will be with everything off."""
    weights = np.zeros(step.matrix.shape[-1])
    weights[step.shown] = 1.0
    for _ in range(STORED_STEPS):
        weights = weights @ step.matrix[0]
    return weights


def _children(
    step: LinearStep,
    goal: PlanningProblem,
    start: PlanStart,
    drift: Floats,
    level: _Level,
    weights: Floats,
    k: int,
) -> _Children:
    mode = step.mode(level.fan[:, None], np.arange(len(step.fans))[None])
    base = np.einsum("mfij,mj->mfi", step.matrix[mode], level.state) + drift[mode]
    base += step.late[mode] * step.share[level.level][:, None, None]
    air = base[..., step.shown, None] + step.now[mode, step.shown][..., None] * step.share
    levels = np.arange(HEATER_LEVELS + 1)
    tracking = _tracking(step, goal, start, level, mode, air, k)
    cost = level.cost[:, None, None] + tracking + goal.effort(levels, step.fans[:, None])
    hold, starts, allowed = _relay(step.fans, goal, level)
    if k in goal.rest:
        cost += REST_WEIGHT * ((levels > 0) | (step.fans[:, None] > 0.0))
    cost[~allowed] = np.inf
    cost[:, :, goal.heater_levels + 1 :] = np.inf
    stored = (base @ weights)[..., None] + (step.now[mode] @ weights)[..., None] * step.share
    return _Children(cost, stored, base, mode, hold, starts)


def _tracking(
    step: LinearStep, goal: PlanningProblem, start: PlanStart, level: _Level, mode: Ints, air: Floats, k: int
) -> Floats:
    """Return the cost of following the reference in step k [M, F, 21], the course within the step with it."""
    cost, size = goal.tracking(air, k), level.state.shape[1]
    looks = step.within.shape[1]
    for look in range(looks):
        row = step.within[:, look]
        drift = row[:, size] + row[:, size + 1] * start.ambient + row[:, size + 4] * start.disturbance
        within = (level.state @ row[:, :size].T)[np.arange(len(mode))[:, None], mode] + drift[mode]
        within += row[mode, size + 3] * step.share[level.level][:, None]
        cost = cost + goal.tracking(within[..., None] + row[mode, size + 2][..., None] * step.share, k)
    return np.asarray(cost / (looks + 1))


def _relay(fans: Floats, goal: PlanningProblem, level: _Level) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Return for each child [M, F] the steps to hold, the starts left, and whether the relay allows it."""
    before, held, rules = level.fan[:, None], level.hold[:, None], goal.fan_rules
    runs, at_end = (fans > 0.0)[None], (fans == 1.0)[None]
    starts = level.starts[:, None] - (runs & (before == 0))
    switched = (runs != (before == 1)) | (runs & ~at_end)
    begun = np.where(at_end, rules.min_on, rules.min_off) - 1
    hold = np.where(switched, begun, np.maximum(held - 1, 0))
    return hold, starts, ~(switched & (held > 0)) & (starts >= 0)


def _cheapest(children: _Children, width: int) -> Ints:
    """Places of the cheapest child of each kind, the `width` cheapest of them."""
    cost = children.cost.ravel()
    kinds = np.rint(children.stored / KIND_K).astype(np.int64)
    kinds -= kinds.min()
    kinds *= 2
    kinds[:, -1] += 1  # a fan that is on at the end makes another kind
    places = kinds.ravel()
    least = np.full(int(places.max()) + 2, np.inf)
    np.minimum.at(least, places, cost)
    cheapest = np.flatnonzero((cost == least[places]) & np.isfinite(cost))
    best = np.full(len(least), -1)
    best[places[cheapest]] = cheapest  # of equal costs the last stays
    best = best[best >= 0]
    if len(best) > width:
        best = best[np.argsort(cost[best], kind="stable")[:width]]
    return np.asarray(best)


def _next(step: LinearStep, children: _Children, kept: Ints) -> _Level:
    parent, place, level = np.unravel_index(kept, children.cost.shape)
    mode = children.mode[parent, place]
    return _Level(
        state=children.base[parent, place] + step.now[mode] * step.share[level][:, None],
        cost=children.cost.ravel()[kept],
        fan=(step.fans[place] == 1.0).astype(np.int64),
        place=place,
        level=level,
        hold=children.hold[parent, place],
        starts=children.starts[parent, place],
        parent=parent,
    )


def _tail_cost(step: LinearStep, goal: PlanningProblem, drift: Floats, level: _Level) -> Floats:
    """Tracking over the tail, fan still, at the constant heat that serves each node best, [M]."""
    if goal.tail == 0:
        return np.zeros(len(level.cost))
    off, by_heat = level.state, np.zeros_like(level.state)
    mode = step.mode(level.fan, np.zeros_like(level.fan))
    late = step.late[mode] * step.share[level.level][:, None]
    free, response = [], []
    for k in range(goal.tail):
        matrix = step.matrix[mode]
        off = np.einsum("mij,mj->mi", matrix, off) + drift[mode] + (late if k == 0 else 0.0)
        by_heat = np.einsum("mij,mj->mi", matrix, by_heat) + step.now[mode] + (step.late[mode] if k else 0.0)
        mode = np.zeros_like(mode)
        free.append(off[:, step.shown])
        response.append(by_heat[:, step.shown])
    without, gain = np.stack(free, axis=1), np.stack(response, axis=1)
    missing = goal.reference[goal.horizon :] - without
    share = (missing * gain).sum(axis=1) / np.maximum((gain**2).sum(axis=1), 1e-12)
    share = np.clip(share, 0.0, step.share[goal.heater_levels])
    temps = without + share[:, None] * gain
    return np.asarray(goal.tracking(temps, slice(goal.horizon, None)).sum(axis=1))


def _result(step: LinearStep, trace: list[_Level], total: Floats, nodes: int) -> BeamResult:
    first = np.arange(len(trace[1].cost))
    for level in trace[2:]:
        first = first[level.parent]
    best = int(np.argmin(total))
    begins = len(step.fans) * trace[1].level + trace[1].place
    other = np.where(begins[first] == begins[first[best]], np.inf, total)
    second = int(np.argmin(other))
    plan, states = _trace_back(step, trace, best, float(total[best]))
    runner_up = (
        _trace_back(step, trace, second, float(total[second]))[0] if np.isfinite(other[second]) else None
    )
    return BeamResult(plan, states[:, step.shown], runner_up, nodes)


def _trace_back(step: LinearStep, trace: list[_Level], node: int, cost: float) -> tuple[Plan, Floats]:
    levels, fans, states = [], [], []
    for level in reversed(trace[1:]):
        levels.append(level.level[node])
        fans.append(step.fans[level.place[node]])
        states.append(level.state[node])
        node = int(level.parent[node])
    return Plan(np.array(levels[::-1]), np.array(fans[::-1]), cost), np.array(states[::-1])


def relay(on: bool, hold: int, min_on: int, min_off: int, horizon: int) -> FanRules:
    """Return the relay's rules for a plan of `horizon` steps."""
    return FanRules(on, min(max(hold, 0), horizon), max(min_on, 1), max(min_off, 1))
