"""python -m bench.mpc_rollout: the MPC over each predictor beside the ARX-MPC's plan applied to that model.

Instances are logged from a closed-loop day on the virtual board; their estimates, offset included, are those
of the ARX's filter, whichever model is then planned with. Every plan is priced by the predictor's own
rollout. Cost is the sum over all instances divided by the sum of the best known (of all rows, and of a search
with 100 times the rollouts from six starts); times are CPU times of one thread for a whole decision.
"""

import argparse
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: CPU time is of one thread

import numpy as np

from bench.closed_loop_day import CHAMBER, DAY_YAML
from bench.twin import TWINS
from edge.app import controllers as registry
from edge.bundle.manifest import MANIFEST, parse_manifest
from edge.bundle.predictors import load_predictors
from edge.bundle.store import PACKAGED_FOLDER
from edge.config import loading as config
from edge.config.settings import ControlSettings
from edge.controllers.mixed_integer.problem import Plan
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.controllers.mpc import MpcSettings, planning_problem
from edge.controllers.mpc_rollout import MpcRollout
from edge.controllers.rollout_search import Meter, RolloutSearch, plan_rollouts
from edge.core.controller import Context, Controller
from edge.core.messages import Decision
from edge.core.predictor import Predictor
from edge.models.arx import Arx
from edge.models.arx_file import read_arx
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin
from training.lab import Lab

_FOREVER_S = 1e9
_MANY = 100  # times the rollouts
_FAN_WEIGHTS = (0.0, 3.0, 10.0, 30.0, 100.0)  # more, of the plans that the long search begins at
_BUDGETS = (100, 200, 400)


class Logger:
    """A controller that keeps what it is asked."""

    def __init__(self, inner: Controller) -> None:
        self.name = inner.name
        self.contexts: list[Context] = []
        self._inner = inner

    def decide(self, context: Context) -> Decision:
        """As the inner one."""
        self.contexts.append(context)
        return self._inner.decide(context)

    def reset(self) -> None:
        """As the inner one."""
        self._inner.reset()


def logged_contexts(controller: str, model: Predictor, seed: int, hours: float) -> list[Context]:
    """One per tick from midnight on: the day of `bench.closed_loop_day`, the daemon in lock-step."""
    settings = config.parse(DAY_YAML, "logged_contexts")
    settings = replace(settings, control=replace(settings.control, controller=controller))
    logger = Logger(registry.make(controller, registry.ControllerParts(settings.control, model)))
    with Lab(settings, seed=seed, chamber=CHAMBER, more_controllers=(logger,)) as lab:
        lab.run(minutes=60.0 * hours)
    return logger.contexts


@dataclass(frozen=True, slots=True)
class PlannerRow:
    """One way to plan, on all instances."""

    name: str
    costs: list[float]
    times_ms: list[float]
    rollouts: list[int]


def predictors(arx: Arx) -> dict[str, Predictor]:
    """Those of the default bundle, as far as there is one, and two twins with given parameters."""
    found: dict[str, Predictor] = {"arx": arx}
    manifest = PACKAGED_FOLDER / MANIFEST
    if manifest.exists():
        found |= load_predictors(PACKAGED_FOLDER, parse_manifest(manifest.read_bytes()), arx.step_s)
    for name in ("loss and capacity", "wall, lag, capacity"):
        found[f"twin: {name}"] = Pbm(BoxTwin(effects=TWINS[name]))
    return found


def rows(model: Predictor, arx: Arx, contexts: Sequence[Context], settings: MpcSettings) -> list[PlannerRow]:
    """Apply the linear planner's plan to `model`, then searches of growing budget."""
    found = []
    for budget in (0, *_BUDGETS):
        controller = MpcRollout("MPC", model, arx, settings, budget)
        row = PlannerRow("ARX-MPC's plan" if budget == 0 else f"search, {budget} rollouts", [], [], [])
        for context in contexts:
            controller.reset()  # each instance alone
            begun = time.process_time()
            why = controller.decide(context).why
            row.times_ms.append(1e3 * (time.process_time() - begun))
            row.costs.append(why["cost"])
            row.rollouts.append(why["rollouts"])
        found.append(row)
    return found


def best_known(model: Predictor, arx: Arx, context: Context, settings: MpcSettings) -> float:
    """Cost found by a long search from several starts."""
    problem = planning_problem(
        context, arx, settings.weight, settings.horizon, settings.preview, settings.tail
    )
    estimate = context.estimate
    held = arx.duty_to_hold(float(problem.reference[-1]), estimate.temp_ambient, estimate.offset)
    costly = [replace(problem, fan_weight=problem.fan_weight + more) for more in _FAN_WEIGHTS]
    starts = [solve(one, settings.node_budget, TimeBox(_FOREVER_S)).plan for one in costly]
    still = np.zeros(problem.horizon, dtype=np.int64)
    if problem.allows(still, still):
        starts.append(Plan(still, still, np.inf))
    meter = Meter(TimeBox(_FOREVER_S), _MANY * _BUDGETS[-1])
    search = RolloutSearch(plan_rollouts(context, model, problem, held), meter)
    search.run(starts)
    return search.best.plan.cost


def table(found: list[PlannerRow], known: Sequence[float]) -> list[str]:
    """Return a line per row."""
    linear = np.array(found[0].costs)
    best = np.min([known, *(row.costs for row in found)], axis=0)
    lines = []
    for row in found:
        costs = np.array(row.costs)
        ratio = costs.sum() / best.sum()
        near = 100.0 * np.mean(costs <= 1.01 * best + 0.01)
        above = int((costs > linear * (1.0 + 1e-9)).sum())
        spent = f"{np.median(row.times_ms):8.1f} {np.percentile(row.times_ms, 99):8.1f}"
        lines.append(
            f"{row.name:24} {ratio:9.4f} {near:8.1f} {above:6d} {np.median(row.rollouts):9.0f} {spent}"
        )
    return lines


def main(words: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.mpc_rollout", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="of closed loop")
    parser.add_argument("--every", type=int, default=14, help="ticks from instance to instance")
    parser.add_argument("--seed", type=int, default=1, help="of the virtual board")
    words = sys.argv[1:] if words is None else words
    options = parser.parse_args(words)
    arx, control = read_arx(), ControlSettings()
    print(f"python -m bench.mpc_rollout {' '.join(words)}".rstrip())
    print(
        f"python {platform.python_version()}, numpy {np.__version__}, {platform.machine()}; arx {arx.version}"
    )
    print(f"N = {control.horizon}, tail {control.tail}, {control.node_budget} nodes for the linear planner;")
    print("near: share of instances within 1 % of the best known; above: instances above the ARX-MPC's plan")
    for name, weight in (("MPC", 0.0), ("MPC-P", 1.0)):
        # From the sixth tick on: before it the estimator has not settled.
        contexts = logged_contexts(name, arx, options.seed, options.hours)[5 :: options.every]
        settings = MpcSettings(
            weight, control.horizon, control.node_budget, _FOREVER_S, control.preview, control.tail
        )
        for label, model in predictors(arx).items():
            print(f"\n{name} on {label}, {len(contexts)} instances")
            print(
                f"{'':24} {'cost':>9} {'near %':>8} {'above':>6} {'rollouts':>9} {'ms':>8} {'p99 ms':>8}",
                flush=True,
            )
            known = [best_known(model, arx, context, settings) for context in contexts]
            for line in table(rows(model, arx, contexts, settings), known):
                print(line, flush=True)


if __name__ == "__main__":
    main()
