"""Other ways to solve the same planning problem."""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, PlanningProblem, lower_toeplitz
from edge.controllers.mpc_bfgs import rounded_bfgs
from edge.core.names import HEATER_LEVELS

Ints = NDArray[np.int64]
Answer = tuple[Ints, Ints, bool]  # heater levels, fan, proven optimal
_REGULARISATION = 1e-6  # daqp needs a positive definite Hessian


def scipy_bfgs(problem: PlanningProblem) -> Answer:
    """Return the paper's plan: L-BFGS-B within the bounds, rounded."""
    levels, fan, _ = rounded_bfgs(problem)
    return levels, fan, False


def daqp_rounded(problem: PlanningProblem, limit_s: float) -> Answer:
    """daqp with a binary fan; its continuous heater is rounded to the grid."""
    import daqp

    n = problem.horizon
    response = np.hstack([lower_toeplitz(problem.heater, n), lower_toeplitz(problem.fan, n)])
    hessian = 2.0 * TRACKING_WEIGHT * response.T @ response
    hessian += np.diag(np.repeat([2.0 * problem.heater_weight, 0.0], n) + _REGULARISATION)
    linear = 2.0 * TRACKING_WEIGHT * response.T @ (problem.free - problem.reference)
    linear += np.repeat([0.0, problem.fan_weight], n)
    sense = np.repeat([0, 16], n).astype(np.int32)
    none = np.zeros((0, 2 * n))
    bounds = np.ones(2 * n), np.zeros(2 * n)
    inputs, *_ = daqp.solve(hessian, linear, none, *bounds, sense, time_limit=limit_s)
    inputs = np.clip(inputs, 0.0, 1.0)
    levels = np.rint(inputs[:n] * HEATER_LEVELS).astype(np.int64)
    return levels, np.rint(inputs[n:]).astype(np.int64), False


def scip(problem: PlanningProblem, limit_s: float) -> Answer:
    """SCIP on the whole mixed-integer quadratic problem, heater levels as integers."""
    from pyscipopt import Model, quicksum

    n = problem.horizon
    model = Model()
    model.hideOutput()
    # Processor time: a busy machine must not shorten a peer's search.
    model.setParam("timing/clocktype", 1)
    model.setParam("limits/time", limit_s)
    model.setParam("limits/gap", 0.0)
    levels = [model.addVar(vtype="I", lb=0, ub=problem.heater_levels) for _ in range(n)]
    fan = [model.addVar(vtype="B") for _ in range(n)]
    error = [model.addVar(lb=None) for _ in range(n)]
    for k in range(n):
        heated = quicksum(problem.heater[k - j] / HEATER_LEVELS * levels[j] for j in range(k + 1))
        fanned = quicksum(problem.fan[k - j] * fan[j] for j in range(k + 1))
        model.addCons(error[k] == float(problem.free[k] - problem.reference[k]) + heated + fanned)
    total = model.addVar(lb=0.0)
    effort = quicksum(problem.heater_weight / HEATER_LEVELS**2 * u * u for u in levels)
    effort += quicksum(problem.fan_weight * f for f in fan)
    model.addCons(total >= TRACKING_WEIGHT * quicksum(e * e for e in error) + effort)
    model.setObjective(total, "minimize")
    model.optimize()
    if not model.getNSols():
        nothing = np.zeros(n, dtype=np.int64)
        return nothing, nothing, False
    plan = [np.array([round(model.getVal(v)) for v in variables]) for variables in (levels, fan)]
    return plan[0], plan[1], model.getStatus() == "optimal"
