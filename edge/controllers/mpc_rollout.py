"""Model predictive control with any predictor: the plan that costs least by its own rollouts, by search."""

import time
from typing import Any

from edge.controllers.mixed_integer.problem import Plan, PlanningProblem
from edge.controllers.mpc import (
    MpcSettings,
    Previous,
    binding,
    cost_split,
    first_command,
    planned_inputs,
    planning_problem,
    runner_up,
    shift_plan,
)
from edge.controllers.rollout_search import Meter, PlanRollouts, PricedPlan, RolloutSearch, plan_rollouts
from edge.core.controller import Context
from edge.core.messages import Decision
from edge.core.names import HEATER_LEVELS
from edge.core.predictor import Predictor
from edge.models.arx import Arx


class MpcRollout:
    """`MPC` and `MPC-P` over a predictor that is not linear.

    The search begins at the plan that `Mpc` finds with the linear model, so by the predictor's own rollouts
    no plan costs more than that one. The predictor must add `ahead["offset"]` [K/step] at every step and go
    on from there, as `edge.models.arx.Arx` does: it is how the plan is free of offset.
    """

    def __init__(
        self, name: str, model: Predictor, planner: Arx, settings: MpcSettings, rollout_budget: int
    ) -> None:
        """`planner` is the linear model of the first plan; `rollout_budget` counts plans and probes."""
        self.name = name
        self._model = model
        self._planner = planner
        self._settings = settings
        self._budget = rollout_budget
        self.reset()

    def reset(self) -> None:
        """Forget the last plans, which the next search would start from."""
        self._previous: Previous | None = None
        self._linear: Previous | None = None  # the planner's own, so that it goes on as `Mpc` would

    def decide(self, context: Context, node_limit: int | None = None) -> Decision:
        """Return the first step of the cheapest plan found.

        node_limit : replay a decision whose time box fired after so many nodes and rollouts
        Raises : DataError when the forecast or the reference is no number, or the predictor fails
        """
        begun = time.perf_counter()
        settings = self._settings
        meter = Meter(settings.time_box(), self._budget, node_limit)
        problem = planning_problem(
            context, self._planner, settings.weight, settings.horizon, settings.preview, settings.tail
        )
        held = self._planner.duty_to_hold(
            float(problem.reference[-1]), context.estimate.temp_ambient, context.estimate.offset
        )
        rollouts = plan_rollouts(context, self._model, problem, held)
        # Rollouts are dear, so they begin from the exact plan over a linear model.
        linear = meter.linear_plan(problem, settings.node_budget, shift_plan(self._linear, context))
        self._linear = Previous(context.now_s, linear.levels, linear.fan)
        search = RolloutSearch(rollouts, meter)
        search.run([linear, *self._last(problem, context)])
        best = search.best
        self._previous = Previous(context.now_s, best.plan.levels, best.plan.fan)
        why = {
            **self._why(rollouts, search, best),
            "solve_ms": round(1e3 * (time.perf_counter() - begun), 3),
        }
        forecast = tuple(best.temps[: problem.horizon].tolist())
        return Decision(first_command(best.plan), self.name, forecast, why, planned_inputs(best.plan))

    def _last(self, problem: PlanningProblem, context: Context) -> list[Plan]:
        """Return the last plan shifted to the present, if it is allowed."""
        last = shift_plan(self._previous, context)
        if last is None or len(last[0]) != problem.horizon or not problem.allows(*last):
            return []
        return [Plan(*last, cost=float("inf"))]

    def _why(self, rollouts: PlanRollouts, search: RolloutSearch, best: PricedPlan) -> dict[str, Any]:
        goal, plan, meter = rollouts.goal, best.plan, search.meter
        return {
            **cost_split(goal, plan.levels / HEATER_LEVELS, plan.fan, best.temps),
            "bound": None,  # no rollout tells what no plan can beat
            "gap": None,
            "proven": False,
            "nodes": meter.spent,
            "rollouts": meter.rollouts,
            "time_box_fired": meter.fired,
            "binding": binding(goal, plan, best.temps),
            "runner_up": runner_up(plan, search.runner_up),
            "reference_c": goal.reference.tolist() if self._settings.preview else float(goal.reference[0]),
            "model": f"{self._model.name} {self._model.version}",
        }
