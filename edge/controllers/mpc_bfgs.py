"""The paper's own MPC, for comparison: continuous BFGS, then clipped and rounded; no constraint but 0..1."""

import time
from typing import Any

import numpy as np

from edge.controllers.base import Context, Floats
from edge.controllers.mixed_integer.problem import Ints, Problem
from edge.controllers.mpc import planning_problem
from edge.controllers.plan_why import cost_split
from edge.messages import Command, Decision
from edge.models.arx import Arx
from edge.names import HEATER_LEVELS

_ITERATIONS = 200


class MpcBfgs:
    """`MPC-BFGS` and `MPC-BFGS-P`. The plan knows no limits; its first step is made to keep them."""

    def __init__(self, name: str, model: Arx, weight: float, horizon: int) -> None:
        self.name = name
        self._model = model
        self._weight = weight
        self._horizon = horizon

    def reset(self) -> None:
        """Nothing to forget: every search starts from half heat and half fan."""

    def decide(self, context: Context) -> Decision:
        """The first step of the rounded plan. Raises DataError as `Mpc.decide`."""
        begun = time.perf_counter()
        problem = planning_problem(context, self._model, self._weight, self._horizon, preview=False)
        levels, fan, iterations = rounded_bfgs(problem)
        levels[0] = min(levels[0], problem.heater_levels)
        if problem.fan_rules.hold:
            fan[0] = problem.fan_rules.on
        temps = problem.temperatures(levels, fan)
        why: dict[str, Any] = {
            **cost_split(problem, levels / HEATER_LEVELS, fan, temps),
            "iterations": iterations,
            "binding": [],
            "runner_up": None,
            "reference_c": float(problem.reference[0]),
            "model": f"{self._model.name} {self._model.version}",
            "solve_ms": round(1e3 * (time.perf_counter() - begun), 3),
        }
        command = Command(int(levels[0]) / HEATER_LEVELS, bool(fan[0]))
        return Decision(command, self.name, tuple(temps.tolist()), why)


def rounded_bfgs(problem: Problem) -> tuple[Ints, Ints, int]:
    """Heater levels and fan [N] of the unconstrained optimum clipped to 0..1 and rounded; BFGS iterations."""
    from scipy.optimize import minimize  # late: it doubles the daemon's memory

    n = problem.horizon

    def cost(inputs: Floats) -> float:
        duty, fan = inputs[:n], inputs[n:]
        temps = problem.temperatures(duty * HEATER_LEVELS, fan)  # type: ignore[arg-type]  # continuous here
        effort = problem.heater_weight * duty @ duty + problem.fan_weight * fan @ fan
        return float(problem.tracking(temps).sum() + effort)

    found = minimize(cost, np.full(2 * n, 0.5), method="BFGS", options={"maxiter": _ITERATIONS})
    inputs = np.clip(found.x, 0.0, 1.0)
    levels = np.rint(inputs[:n] * HEATER_LEVELS).astype(np.int64)
    return levels, np.rint(inputs[n:]).astype(np.int64), int(found.nit)
