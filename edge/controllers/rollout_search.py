"""The cheapest plan by a predictor's real rollouts that a search of changes finds, whatever the predictor is.

Around a plan the predictor is asked what every single change does. That makes a linear picture of it there;
near plans are ranked by the picture and the most promising are rolled out for real, all in one batch. The
best of them is the next plan to look around, until none is better. Nothing is proven.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.polish import Local, fan_variants, neighbours
from edge.controllers.mixed_integer.problem import Plan, PlanningProblem
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.controllers.mpc import LIMIT_WEIGHT, pad
from edge.core.controller import Columns, Context
from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.core.predictor import Predictor
from edge.twin.warm_start import hold as last_known

Ints = NDArray[np.int64]

Floats = NDArray[np.float64]

_DUTIES = np.linspace(0.0, 1.0, 6)  # between which the duty that holds a temperature is interpolated
_STOOD_ROWS = 30  # for a model that looks back: how long the box has stood at that temperature


@dataclass(frozen=True, slots=True, eq=False)
class PlanRollouts:
    """Plans of one context by one predictor.

    goal : the planning problem whose costs and rules hold; its own forecast does not
    ahead : of all N + M steps; `offset` [K/step] is what the predictor adds to every step and feeds back
    held : heater duty over the tail
    """

    model: Predictor
    history: Columns
    ahead: Columns
    goal: PlanningProblem
    held: float

    def temperatures(self, levels: Ints, fan: Ints) -> Floats:
        """Air temperature after each step of plans [B, N], the tail's too: [B, N + M] [°C].

        Raises : DataError naming the predictor when it fails or forecasts what is no number
        """
        controls = np.zeros((len(levels), len(self.goal.reference), 2))
        controls[:, : self.goal.horizon, 0] = levels / HEATER_LEVELS
        controls[:, : self.goal.horizon, 1] = fan
        controls[:, self.goal.horizon :, 0] = self.held
        return forecast(self.model, self.history, controls, self.ahead)


def plan_rollouts(context: Context, model: Predictor, linear: PlanningProblem, held: float) -> PlanRollouts:
    """Return the rollouts and costs for a context.

    linear : the linear planner's problem for it, of which reference, weights and limits are taken
    held : a first guess of the duty that holds the reference
    """
    ahead = ahead_with_offset(context, len(linear.reference))
    if linear.tail:
        held = _holding_duty(context, model, float(linear.reference[-1]), held, linear.tail)
    return PlanRollouts(
        model=model,
        history=pad(context.history, model.rows_needed),
        ahead=ahead,
        goal=replace(linear, limit_weight=LIMIT_WEIGHT),
        held=min(held, context.limits.heater_max_duty),
    )


def forecast(model: Predictor, history: Columns, controls: Floats, ahead: Columns) -> Floats:
    """Roll a predictor out, [B, N] [°C]. Errors: DataError with its name, however it fails"""
    try:
        temps = model.rollout(history, controls, ahead)
    except Exception as error:  # of any library behind the seam; the fallback controller decides then
        raise DataError(f"{model.name} {model.version}: {error}") from error
    if temps.shape != controls.shape[:2]:
        raise DataError(
            f"{model.name} {model.version}: {temps.shape} temperatures for {controls.shape[:2]} steps"
        )
    if not np.isfinite(temps).all():
        raise DataError(f"{model.name} {model.version}: a forecast is no number")
    return np.asarray(temps, dtype=np.float64)


def ahead_with_offset(context: Context, steps: int) -> Columns:
    """Return the columns of the coming steps: measured values hold, time goes on."""
    ahead = {
        name: np.full(steps, last_known(column)[-1])
        for name, column in context.history.items()
        if name not in ("temp_air", "temp_air_measured", "heater_duty", "fan_on")
    }
    for name in ahead.keys() & {"time_s", "utc"}:
        ahead[name] = ahead[name] + context.step_s * np.arange(steps)
    return ahead | {
        "temp_ambient": np.full(steps, context.estimate.temp_ambient),
        "offset": np.full(steps, context.estimate.offset),
    }


def _holding_duty(context: Context, model: Predictor, temp_air: float, guess: float, steps: int) -> float:
    """Heater duty 0..1 that holds `temp_air` [°C] over so many steps, fan off, by the predictor's own word.

    guess : the duty at which the box is taken to have stood there before
    """
    rows = max(model.rows_needed, _STOOD_ROWS)
    stood = {key: np.full(rows, column[-1]) for key, column in context.history.items()}
    stood |= {
        "temp_air": np.full(rows, temp_air),
        "temp_ambient": np.full(rows, context.estimate.temp_ambient),
        "heater_duty": np.full(rows, guess),
        "fan_on": np.zeros(rows),
    }
    ahead = ahead_with_offset(context, steps)
    controls = np.zeros((len(_DUTIES), steps, 2))
    controls[:, :, 0] = _DUTIES[:, None]
    off = forecast(model, stood, controls, ahead).mean(axis=1) - temp_air
    return float(np.interp(0.0, np.maximum.accumulate(off), _DUTIES))


_LEVELS_MORE = (1, -1, 2, -2, 5, -5)


def small_moves(problem: PlanningProblem, local: Local, count: int) -> list[Plan]:
    """At most `count` allowed plans one move from the known one, the cheapest by `local` first."""
    heated, blown = _heater_plans(local.levels, problem.heater_levels), fan_variants(local.fan)
    levels = np.concatenate([heated, np.broadcast_to(local.levels, blown.shape)])
    fan = np.concatenate([np.broadcast_to(local.fan, heated.shape), blown])
    allowed = problem.allows(levels, fan)
    levels, fan = levels[allowed], fan[allowed]
    cost = problem.cost_at(local.temperatures(levels, fan), levels, fan)
    cheapest = np.argsort(cost, kind="stable")[:count]
    return [Plan(levels[place], fan[place], float(cost[place])) for place in cheapest]


def _heater_plans(levels: Ints, top: int) -> Ints:
    """Every stretch of steps raised or lowered, and heat moved to the step after or before, each once."""
    n = len(levels)
    first, last = np.triu_indices(n)
    step = np.arange(n)
    stretch = ((step >= first[:, None]) & (step <= last[:, None])).astype(np.int64)
    single = np.eye(n, dtype=np.int64)
    moves = [stretch * more for more in _LEVELS_MORE]
    moves += [(single[1:] - single[:-1]) * more for more in _LEVELS_MORE]
    plans = np.unique(np.clip(levels + np.concatenate(moves), 0, top), axis=0)
    return np.asarray(plans[(plans != levels).any(axis=1)])


_BATCH = 32  # near plans that are rolled out at once
_SMALL_MOVES = 3 * _BATCH
_LINEAR_NODES = 2000


@dataclass(slots=True)
class Meter:
    """Counts the work and says when it must end.

    time_box : ends the search
    rollout_budget : rollouts that may be done beside those of the starting plans
    node_limit : to replay a search that the clock ended after so much work
    spent : nodes of the linear planner and rollouts, until the clock ended the search
    """

    time_box: TimeBox
    rollout_budget: int
    node_limit: int | None = None
    spent: int = 0
    rollouts: int = 0
    fired: bool = False

    def allows(self, rollouts: int) -> bool:
        """Asked before each batch; work must lie between two questions, else a replay could mistake them."""
        if self.rollouts + rollouts > self.rollout_budget:
            return False
        limited = self.node_limit is not None and self.spent >= self.node_limit
        self.fired = self.fired or limited or self.time_box.is_over()
        return not self.fired

    def count(self, rollouts: int) -> None:
        """Rollouts that are done."""
        self.rollouts += rollouts
        self.spent += 0 if self.fired else rollouts

    def linear_plan(self, problem: PlanningProblem, node_budget: int, warm: tuple[Ints, Ints] | None) -> Plan:
        """Solve a linear problem with the exact planner and count its nodes."""
        left = None if self.node_limit is None else self.node_limit - self.spent
        solution = solve(problem, node_budget, self.time_box, left, warm)
        self.spent += solution.nodes
        self.fired = self.fired or solution.time_box_fired
        return solution.plan


@dataclass(frozen=True, slots=True, eq=False)
class PricedPlan:
    """A plan with its real cost, and its air temperatures [N + M] [°C]."""

    plan: Plan
    temps: Floats


@dataclass(slots=True)
class RolloutSearch:
    """One search; it holds what was found so far."""

    rollouts: PlanRollouts
    meter: Meter
    _costs: dict[bytes, float] = field(default_factory=dict)
    _by_first_step: dict[tuple[int, int], PricedPlan] = field(default_factory=dict)

    @property
    def best(self) -> PricedPlan:
        """The cheapest plan found."""
        return min(self._by_first_step.values(), key=_cost)

    @property
    def runner_up(self) -> Plan | None:
        """The cheapest plan found that begins otherwise than the best."""
        best = self.best
        others = [priced for priced in self._by_first_step.values() if priced is not best]
        return min(others, key=_cost).plan if others else None

    def run(self, starts: Sequence[Plan]) -> None:
        """Look around the starting plans, the cheapest first; they are priced in any case, time or not."""
        self._price(starts)
        looked_around: set[bytes] = set()
        for start in sorted((self._with_price(start) for start in starts), key=lambda plan: plan.cost):
            plan: Plan | None = start
            while plan is not None and _key(plan) not in looked_around:
                looked_around.add(_key(plan))
                plan = self._better(plan, first=len(looked_around) == 1)

    def _better(self, plan: Plan, first: bool) -> Plan | None:
        """Return a cheaper plan near `plan`, None where none is found or the search must end."""
        goal = self.rollouts.goal
        local = self._picture(plan)
        if local is None:
            return None
        near = neighbours(goal, local, _BATCH)
        if first:
            linear = _linear_problem(goal, local)
            near.append(self.meter.linear_plan(linear, _LINEAR_NODES, (plan.levels, plan.fan)))
        moves = small_moves(goal, local, _SMALL_MOVES)
        for batch in (near, *(moves[at : at + _BATCH] for at in range(0, len(moves), _BATCH))):
            new = [other for other in batch if _key(other) not in self._costs]
            if new and not self.meter.allows(len(new)):
                return None
            self._price(new)
            best = min(
                (self._with_price(other) for other in batch), key=lambda other: other.cost, default=plan
            )
            if best.cost < plan.cost:
                return best
        return None

    def _picture(self, plan: Plan) -> Local | None:
        """Return the effect of each single change of the plan, None without time for it.

        The heater goes one level up, or down where it is at its top; a changed plan may break the relay's
        rules, it is no proposal.
        """
        n = self.rollouts.goal.horizon
        if not self.meter.allows(2 * n + 1):
            return None
        sign = np.where(plan.levels < HEATER_LEVELS, 1, -1)
        none = np.zeros((n, n), dtype=np.int64)
        levels = plan.levels + np.concatenate([none[:1], np.diag(sign), none])
        fan = plan.fan ^ np.concatenate([none[:1], none, np.eye(n, dtype=np.int64)])
        temps = self.rollouts.temperatures(levels, fan)
        self.meter.count(len(levels))
        change = temps[1:] - temps[0]
        return Local(
            plan.levels,
            plan.fan,
            temps[0],
            heater_response=change[:n] * (sign * HEATER_LEVELS)[:, None],
            fan_response=change[n:] * (1 - 2 * plan.fan)[:, None],
        )

    def _price(self, plans: Sequence[Plan]) -> None:
        if not plans:
            return
        goal = self.rollouts.goal
        levels, fan = np.stack([plan.levels for plan in plans]), np.stack([plan.fan for plan in plans])
        temps = self.rollouts.temperatures(levels, fan)
        self.meter.count(len(plans))
        for plan, cost, own in zip(plans, goal.cost_at(temps, levels, fan).tolist(), temps, strict=True):
            self._costs[_key(plan)] = cost
            first = int(plan.levels[0]), int(plan.fan[0])
            known = self._by_first_step.get(first)
            if known is None or cost < known.plan.cost:
                self._by_first_step[first] = PricedPlan(replace(plan, cost=cost), own)

    def _with_price(self, plan: Plan) -> Plan:
        return replace(plan, cost=self._costs[_key(plan)])


def _linear_problem(goal: PlanningProblem, local: Local) -> PlanningProblem:
    """Return the local model in the exact planner's form: one response for all steps, the mean of theirs."""
    n, steps = goal.horizon, len(goal.reference)

    def mean_response(responses: Floats) -> Floats:
        return np.array(
            [np.mean([responses[k, k + lag] for k in range(min(n, steps - lag))]) for lag in range(steps)]
        )

    flat = replace(goal, heater=mean_response(local.heater_response), fan=mean_response(local.fan_response))
    return replace(flat, free=flat.free + local.temps - flat.temperatures(local.levels, local.fan))


def _key(plan: Plan) -> bytes:
    return plan.levels.tobytes() + plan.fan.tobytes()


def _cost(priced: PricedPlan) -> float:
    return priced.plan.cost
