"""python -m bench.mpc: the exact planner beside the paper's and two mixed-integer peers.

Cost is the sum over all instances divided by the sum of the best known (the best over all methods and a
long run of ours). Times are CPU times of one thread. One plant first, then random ones.
"""

import argparse
import itertools
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.metadata import version

from edge.models.arx import Arx

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: CPU time is of one thread

import numpy as np

from bench import closed_loop, peers
from bench.instances import fitted_model, instances
from bench.random_plants import random_problems, ranges
from edge.controllers.mixed_integer.problem import PlanningProblem
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox

HORIZONS = (5, 10, 20, 30)
RANDOM_HORIZONS = (10, 20)
_NO_BUDGET = 10**9  # here the time box alone ends a search
_LONG_S = 2.0
Method = Callable[[PlanningProblem], tuple[float, float, bool]]  # cost, lower bound, proven


def ours(box_s: float) -> Method:
    """Return the planner of `MPC` inside a time box."""

    def method(problem: PlanningProblem) -> tuple[float, float, bool]:
        solution = solve(problem, _NO_BUDGET, TimeBox(box_s, wall_s=np.inf))
        return solution.plan.cost, solution.bound, solution.proven

    return method


def peer(answer: Callable[[PlanningProblem], peers.Answer]) -> Method:
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
        "L-BFGS-B, rounded": peer(peers.scipy_bfgs),
        "daqp, rounded heater": peer(lambda problem: peers.daqp_rounded(problem, options.peer_seconds)),
        f"SCIP, {options.peer_seconds:g} s": peer(lambda problem: peers.scip(problem, options.peer_seconds)),
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
    print(f"clairvoyant: beam of {closed_loop.BEAM} on the box itself, same horizon, no preview;")
    print("the others plan with an ARX model and a disturbance estimate; the box's fan is bilinear")
    for weight in (0.0, 1.0):
        policies = closed_loop.policies(model, excess, 10, weight)
        costs = {
            name: closed_loop.closed_loop_cost(p, weight, references, seed) for name, p in policies.items()
        }
        split = ", ".join(f"{name} {cost / costs['clairvoyant']:.2f}" for name, cost in costs.items())
        print(f"weights ({weight:g}, {weight:g}): {split}", flush=True)


if __name__ == "__main__":
    main()
