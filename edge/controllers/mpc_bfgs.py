"""The paper's own MPC, for comparison: continuous inputs within 0..1 by L-BFGS-B, then rounded."""

import time
from typing import Any

import numpy as np

from edge.controllers.mixed_integer.problem import Ints, PlanningProblem, lower_toeplitz
from edge.controllers.mpc import cost_split, planning_problem
from edge.core.controller import Context, Floats
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS
from edge.models.arx import Arx

_ITERATIONS = 200


class MpcBfgs:
    """`MPC-BFGS` and `MPC-BFGS-P`: the paper's cost with the bounds of its problem.

    preview : as of `MpcSettings`; the paper's knows the present reference alone
    bounded : False drops the bounds and clips afterwards, as a plain BFGS does; for a comparison alone
    """

    def __init__(
        self,
        name: str,
        model: Arx,
        weight: float,
        horizon: int,
        preview: bool = False,
        bounded: bool = True,
    ) -> None:
        self.name = name
        self._model = model
        self._weight = weight
        self._horizon = horizon
        self._preview = preview
        self._bounded = bounded

    def reset(self) -> None:
        """Nothing to forget: every search starts from no heat and no fan."""

    def decide(self, context: Context) -> Decision:
        """Return the first step of the rounded plan. Raises DataError as `Mpc.decide`."""
        begun = time.perf_counter()
        problem = planning_problem(context, self._model, self._weight, self._horizon, self._preview)
        levels, fan, iterations = rounded_bfgs(problem, self._bounded)
        temps = problem.temperatures(levels, fan)
        why: dict[str, Any] = {
            **cost_split(problem, levels / HEATER_LEVELS, fan, temps),
            "iterations": iterations,
            "binding": [],
            "runner_up": None,
            "reference_c": problem.reference.tolist() if self._preview else float(problem.reference[0]),
            "model": f"{self._model.name} {self._model.version}",
            "solve_ms": round(1e3 * (time.perf_counter() - begun), 3),
        }
        command = Command(int(levels[0]) / HEATER_LEVELS, bool(fan[0]))
        return Decision(command, self.name, tuple(temps.tolist()), why)


def rounded_bfgs(problem: PlanningProblem, bounded: bool = True) -> tuple[Ints, Ints, int]:
    """Return heater levels and fan [N] of the continuous optimum, rounded, and the iterations it took.

    bounded : search within the bounds (L-BFGS-B), else without any (BFGS); the answer is clipped to them
    """
    from scipy.optimize import minimize  # late: it doubles the daemon's memory

    n, rules = problem.horizon, problem.fan_rules
    response = np.hstack([lower_toeplitz(problem.heater, n), lower_toeplitz(problem.fan, n)])
    weights = np.repeat([problem.heater_weight, problem.fan_weight], n)
    lowest, highest = np.zeros(2 * n), np.repeat([problem.heater_levels / HEATER_LEVELS, 1.0], n)
    # A relay that must rest has one value only: as a bound it needs no penalty.
    lowest[n : n + rules.hold] = highest[n : n + rules.hold] = float(rules.on)

    def cost(inputs: Floats) -> tuple[float, Floats]:
        temps = problem.free + response @ inputs
        slope = response.T @ problem.tracking_slope(temps) + 2.0 * weights * inputs
        return float(problem.tracking(temps).sum() + weights @ inputs**2), slope

    found = minimize(
        cost,
        lowest,  # among equal plans the search ends near its start: without a penalty that spares the fan
        jac=True,
        method="L-BFGS-B" if bounded else "BFGS",
        bounds=np.column_stack([lowest, highest]) if bounded else None,
        options={"maxiter": _ITERATIONS},
    )
    inputs = np.clip(found.x, lowest, highest)
    levels = np.rint(inputs[:n] * HEATER_LEVELS).astype(np.int64)
    return levels, np.rint(inputs[n:]).astype(np.int64), int(found.nit)
