"""Model predictive control, the paper's cost, solved as the mixed-integer problem it is."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.controllers.base import Columns, Context, Floats
from edge.controllers.mixed_integer.problem import FanRules, Problem
from edge.controllers.mixed_integer.solver import solve
from edge.messages import Command, Decision
from edge.models.base import Predictor
from edge.names import HEATER_LEVELS

_LIMIT_WEIGHT = 1000.0  # a soft limit on the air temperature: 1 K above it costs as much as 10 K off the reference


class Mpc:
    """`MPC` with weight 0, `MPC-P` with weight 1 on heater and fan."""

    def __init__(self, name: str, model: Predictor, weight: float, horizon: int, node_budget: int,
                 time_box_ms: float, preview: bool = False) -> None:
        self.name = name
        self._model = model
        self._weight = weight
        self._horizon = horizon
        self._node_budget = node_budget
        self._time_box_s = 1e-3 * time_box_ms
        self._preview = preview
        self._previous: Any = None

    def reset(self) -> None:
        """Forget the plan that the next search would start from."""
        self._previous = None

    def decide(self, context: Context, node_limit: int | None = None) -> Decision:
        begun = time.perf_counter()
        problem = plan_problem(context, self._model, self._weight, self._horizon, self._preview)
        solution = solve(problem, self._node_budget, self._time_box_s, node_limit)
        temps = problem.temperatures(solution.plan.levels, solution.plan.fan)
        command = Command(heater_duty=float(solution.plan.levels[0]) / HEATER_LEVELS, fan_on=bool(solution.plan.fan[0]))
        why = {"solve_ms": 1e3 * (time.perf_counter() - begun), "cost": solution.plan.cost, "bound": solution.bound,
               "proven": solution.proven, "nodes": solution.nodes, "model": self._model.version}
        return Decision(command, self.name, tuple(float(t) for t in temps), why)


def plan_problem(context: Context, model: Predictor, weight: float, horizon: int, preview: bool) -> Problem:
    """The context as a planning problem; inputs enter an ARX model linearly, so three rollouts tell all of it."""
    controls = np.zeros((3, horizon, 2))
    controls[1, 0, 0] = 1.0
    controls[2, 0, 1] = 1.0
    estimate, limits = context.estimate, context.limits
    ahead = {
        "temp_ambient": np.full(horizon, estimate.temp_ambient),
        "offset": np.full(horizon, estimate.offset),
    }
    free, heated, fanned = model.rollout(padded(context.history, model.rows_needed), controls, ahead)
    reference = context.reference[:horizon] if preview else np.full(horizon, context.reference[0])
    fan_rules = FanRules(context.last_sent.fan_on, min(limits.fan_hold_steps, horizon),
                         max(limits.fan_min_on_steps, 1), max(limits.fan_min_off_steps, 1))
    return Problem(free, heated - free, fanned - free, reference, weight, weight,
                   int(limits.heater_max_duty * HEATER_LEVELS + 1e-9), fan_rules,
                   limits.temp_air_max_c, _LIMIT_WEIGHT)


def padded(history: Columns, rows: int) -> Columns:
    """A history that is too short to start from, as if the oldest row had lasted (its inputs were then off)."""
    missing = rows - len(history["temp_air"])
    if missing <= 0:
        return history
    return {
        key: np.concatenate([np.full(missing, values[0] if key == "temp_air" else 0.0), values])
        for key, values in history.items()
    }
