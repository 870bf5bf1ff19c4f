"""python -m bench.mpc: the exact planner beside the paper's and two mixed-integer peers.

Cost is the sum over all instances divided by the sum of the best known (the best over all methods and a
long run of ours). Times are CPU times of one thread. One plant first (bench/two_node_box.py), then random
ones: boxes of any size, heater and fan, within ranges that are plausible.
"""

import argparse
import itertools
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version

from edge.models.arx import Arx

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: CPU time is of one thread

import numpy as np
from numpy.typing import NDArray

from bench.two_node_box import BEAM, closed_loop_cost, fitted_model, instances, policies
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, FanRules, PlanningProblem, lower_toeplitz
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.controllers.mpc_bfgs import rounded_bfgs
from edge.core.names import HEATER_LEVELS

HORIZONS = (5, 10, 20, 30)
RANDOM_HORIZONS = (10, 20)
_NO_BUDGET = 10**9  # here the time box alone ends a search
_LONG_S = 2.0
Method = Callable[[PlanningProblem], tuple[float, float, bool]]  # cost, lower bound, proven
Ints = NDArray[np.int64]
Answer = tuple[Ints, Ints, bool]  # heater levels, fan, proven optimal
_REGULARISATION = 1e-6  # daqp needs a positive definite Hessian
Floats = NDArray[np.float64]
STEP_MIN = 1.0


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


# Each value is drawn evenly from its range, time constants evenly in their logarithm.
RANGES: Mapping[str, tuple[float, float]] = {
    "air time constant [min]": (5.0, 60.0),
    "heater time constant [min]": (0.5, 8.0),
    "heater dead time [steps]": (0, 3),
    "fan dead time [steps]": (0, 1),
    "rise at full heat [K]": (10.0, 45.0),
    "fall by the fan [K]": (2.0, 25.0),
    "room [degC]": (15.0, 28.0),
    "air above room at the start, share of the rise": (0.0, 0.8),
    "reference above room, share of the rise": (0.1, 0.9),
    "heater's stored heat at the start, share": (0.0, 1.0),
}


def ranges() -> str:
    """Return the ranges as one line."""
    return "; ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in RANGES.items())


def random_problems(count: int, horizon: int, weight: float, seed: int) -> Iterator[PlanningProblem]:
    """Draw `count` problems; the same plants and starts for every horizon and weight."""
    for number in range(count):
        yield _problem(np.random.default_rng([seed, number]), horizon, weight)


def _problem(rng: np.random.Generator, horizon: int, weight: float) -> PlanningProblem:
    """Draw a heater that warms the air, each of first order; the fan cools the air linearly."""
    air_min, heater_min = (np.exp(rng.uniform(*np.log(RANGES[name]))) for name in list(RANGES)[:2])
    heater_late, fan_late = (
        int(rng.integers(int(low), int(high) + 1)) for low, high in list(RANGES.values())[2:4]
    )
    rise, fall, room, above, goal, stored = (rng.uniform(*RANGES[name]) for name in list(RANGES)[4:])
    minutes = STEP_MIN * np.arange(horizon + 1)
    by_air, by_heater = np.exp(-minutes / air_min), np.exp(-minutes / heater_min)
    # The air after a pulse of heat that was in the element, and after a step of the duty, both from rest.
    pulse = heater_min / (heater_min - air_min) * (by_heater - by_air)
    step = 1.0 - (air_min * by_air - heater_min * by_heater) / (air_min - heater_min)
    free = room + rise * (above * by_air + stored * pulse)
    return PlanningProblem(
        free=free[1:],
        heater=_late(rise * np.diff(step), heater_late),
        fan=_late(-fall * np.diff(1.0 - by_air), fan_late),
        reference=np.full(horizon, room + goal * rise),
        heater_weight=weight,
        fan_weight=weight,
        fan_rules=FanRules(on=bool(rng.integers(0, 2))),
    )


def _late(response: Floats, steps: int) -> Floats:
    return np.concatenate([np.zeros(steps), response])[: len(response)]


def ours(box_s: float) -> Method:
    """Return the planner of `MPC` inside a time box."""

    def method(problem: PlanningProblem) -> tuple[float, float, bool]:
        solution = solve(problem, _NO_BUDGET, TimeBox(box_s, wall_s=np.inf))
        return solution.plan.cost, solution.bound, solution.proven

    return method


def peer(answer: Callable[[PlanningProblem], Answer]) -> Method:
    """Return a peer, whose plan is priced by the same function as ours."""

    def method(problem: PlanningProblem) -> tuple[float, float, bool]:
        levels, fan, proven = answer(problem)
        return float(problem.cost(levels, fan)), 0.0, proven

    return method


def compare(problems: list[PlanningProblem], methods: dict[str, Method]) -> list[str]:
    """One line per method; says so when a bound lies above a known plan."""
    costs: dict[str, list[float]] = {}
    bounds: dict[str, list[float]] = {}
    lines: list[tuple[str, str]] = []
    for name, method in methods.items():
        method(problems[0])  # imports and caches are not part of the time
        costs[name], bounds[name], proven, times = [], [], 0, []
        for problem in problems:
            begun = time.process_time()
            cost, bound, sure = method(problem)
            times.append(1e3 * (time.process_time() - begun))
            costs[name].append(cost)
            bounds[name].append(bound)
            proven += sure
        spent = f"{np.median(times):9.2f} {np.percentile(times, 99):9.2f} {max(times):9.2f}"
        lines.append((name, f"{100.0 * proven / len(problems):7.1f} {spent}"))
    long_run = [solve(problem, _NO_BUDGET, TimeBox(_LONG_S, wall_s=np.inf)) for problem in problems]
    known = np.min([*costs.values(), [solution.plan.cost for solution in long_run]], axis=0)
    false = sum(int((np.array(values) > known * (1 + 1e-9) + 1e-9).sum()) for values in bounds.values())
    rows = [f"{name:22} {sum(costs[name]) / known.sum():10.5f} {rest}" for name, rest in lines]
    surely = sum(solution.proven for solution in long_run)
    rows.append(f"{'':22} bounds above a known plan: {false}; best known proven: {surely} of {len(problems)}")
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.mpc", description=__doc__)
    parser.add_argument("--instances", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--peer-seconds", type=float, default=0.25, help="CPU time limit of each peer")
    parser.add_argument("--plants", choices=("all", "random"), default="all", help="random: without the one")
    parser.add_argument("--references", type=int, default=12, help="reference steps of the closed loop")
    options = parser.parse_args()
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "daqp", "pyscipopt"))
    print(f"python -m bench.mpc {' '.join(sys.argv[1:])}")
    print(f"seed {options.seed}; python {platform.python_version()}, {versions}; {platform.machine()}")
    # All limits are of processor time, which a busy machine does not shorten.
    methods = {
        "ours, 20 ms box": ours(0.020),
        "ours, 250 ms box": ours(0.250),
        "L-BFGS-B, rounded": peer(scipy_bfgs),
        "daqp, rounded heater": peer(lambda problem: daqp_rounded(problem, options.peer_seconds)),
        f"SCIP, {options.peer_seconds:g} s": peer(lambda problem: scip(problem, options.peer_seconds)),
    }
    if options.plants == "all":
        one_plant(methods, options)
    print(f"\n{options.instances} random plants: {ranges()}")
    for weight, horizon in itertools.product((0.0, 1.0), RANDOM_HORIZONS):
        print_table(
            f"random plants, weights ({weight:g}, {weight:g}), N = {horizon}",
            list(random_problems(options.instances, horizon, weight, options.seed)),
            methods,
        )


def one_plant(methods: dict[str, Method], options: argparse.Namespace) -> None:
    """Print the tables of one box and its ARX model, and the closed loop on that box."""
    fit = fitted_model(options.seed)
    print(f"plant: two-node box (bench/two_node_box.py), 60 s steps; ARX of order 3 from 12 runs, "
          f"30 steps free run {fit.free_run_rmse_k:.2f} K RMSE; {options.instances} instances")  # fmt: skip
    for weight, label in ((0.0, "MPC, weights (0, 0)"), (1.0, "MPC-P, weights (1, 1)")):
        for horizon in HORIZONS:
            problems = list(instances(fit.model, options.instances, horizon, weight, options.seed))
            print_table(f"{label}, N = {horizon}", problems, methods)
    excess = fitted_model(options.seed, "excess")
    print_closed_loop(fit.model, excess.model, options.references, options.seed)


def print_table(title: str, problems: list[PlanningProblem], methods: dict[str, Method]) -> None:
    """Print one comparison."""
    heads = f"{'cost':>10} {'proven%':>7} {'median ms':>9} {'p99 ms':>9} {'max ms':>9}"
    print(f"\n{title}\n{'':22} {heads}", flush=True)
    for line in compare(problems, methods):
        print(line, flush=True)


def print_closed_loop(model: Arx, excess: Arx, references: int, seed: int) -> None:
    """Cost on the plant itself, relative to the clairvoyant planner's."""
    print(
        f"\nclosed loop on the two-node box, N = 10, {references} reference steps of 20 min, no sensor noise;"
    )
    print(f"clairvoyant: beam of {BEAM} on the box itself, same horizon, no preview;")
    print("the others plan with an ARX model and a disturbance estimate; the box's fan is bilinear")
    for weight in (0.0, 1.0):
        costs = {
            name: closed_loop_cost(policy, weight, references, seed)
            for name, policy in policies(model, excess, 10, weight).items()
        }
        split = ", ".join(f"{name} {cost / costs['clairvoyant']:.2f}" for name, cost in costs.items())
        print(f"weights ({weight:g}, {weight:g}): {split}", flush=True)


if __name__ == "__main__":
    main()
