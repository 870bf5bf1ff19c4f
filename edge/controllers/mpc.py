"""Model predictive control: the paper's cost, solved as the mixed-integer problem it is, and the reasons
for a plan.
"""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.controllers.mixed_integer.problem import FanRules, Ints, Plan, PlanningProblem
from edge.controllers.mixed_integer.solver import Solution, solve
from edge.controllers.mixed_integer.time_box import WALL_FACTOR, TimeBox
from edge.core.controller import Columns, Context, Floats, goal_ahead
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS, levels_allowed
from edge.models.arx import Arx


def cost_split(problem: PlanningProblem, duty: Floats, fan: Ints, temps: Floats) -> dict[str, float]:
    """Split a plan's cost into its parts."""
    heater = float(problem.heater_weight * (duty**2).sum())
    fan_cost = float(problem.fan_weight * fan.sum() + problem.clash_weight * (duty * fan).sum())
    tracking = float(problem.tracking(temps).sum())
    return {
        "cost": tracking + heater + fan_cost,
        "cost_tracking": tracking,
        "cost_heater": heater,
        "cost_fan": fan_cost,
    }


def binding(problem: PlanningProblem, plan: Plan, temps: Floats) -> list[str]:
    """Return the constraints that shape the plan, those of the first step first."""
    rules, found = problem.fan_rules, []
    if plan.levels[0] == problem.heater_levels:
        found.append("heater at its upper limit")
    if plan.levels[0] == 0:
        found.append("heater at 0")
    if rules.hold > 0:
        found.append(f"fan held {'on' if rules.on else 'off'} by its relay")
    if not temps.max() < problem.temp_max:
        found.append("air temperature limit")
    return found


def runner_up(plan: Plan, other: Plan | None) -> dict[str, float | bool] | None:
    """Return the best known plan with another first step, and its extra cost; None if there is none."""
    if other is None:
        return None
    command = first_command(other)
    return {
        "heater_duty": command.heater_duty,
        "fan_on": command.fan,
        "cost_more": other.cost - plan.cost,
    }


def first_command(plan: Plan) -> Command:
    """Return the plan's command for the step that begins now."""
    fan = float(plan.fan[0])
    return Command(int(plan.levels[0]) / HEATER_LEVELS, fan > 0.0, fan_share=fan or 1.0)


def planned_inputs(plan: Plan) -> tuple[tuple[float, float], ...]:
    """Heater duty and fan of each step, as `Decision.plan` has them."""
    return tuple(zip((plan.levels / HEATER_LEVELS).tolist(), map(float, plan.fan), strict=True))


LIMIT_WEIGHT = 1000.0  # 1 K above the soft limit costs as much as 10 K off the reference

WALL_SHARE = 0.8  # of the decision's deadline; polish and runner-up follow the search


@dataclass(frozen=True, slots=True)
class MpcSettings:
    """The parts and settings of an MPC.

    weight : on heater and fan effort, 0 for `MPC`, 1 for `MPC-P` (paper, section MPC)
    node_budget : see `mixed_integer.solver.solve`
    time_box_s : CPU time of a search [s]
    decision_s : wall time that a decision may take [s]
    preview : plan for the coming reference; False is the paper's, which holds the present one
    """

    weight: float
    horizon: int
    node_budget: int
    time_box_s: float
    preview: bool = False
    tail: int = 0
    decision_s: float = 4.0

    def time_box(self) -> TimeBox:
        """Return the time box of one decision; it ends before the decision is late."""
        wall_s = max(self.time_box_s, WALL_SHARE * self.decision_s)
        return TimeBox(self.time_box_s, min(WALL_FACTOR * self.time_box_s, wall_s))


@dataclass(frozen=True, slots=True, eq=False)
class Previous:
    """A plan and when it was made, inputs [N]."""

    now_s: float
    levels: Ints
    fan: Ints


class Mpc:
    """`MPC` and `MPC-P`."""

    def __init__(self, name: str, model: Arx, settings: MpcSettings) -> None:
        self.name = name
        self._model = model
        self._settings = settings
        self._previous: Previous | None = None

    def reset(self) -> None:
        """Forget the last plan, which the next search would start from."""
        self._previous = None

    def decide(self, context: Context, node_limit: int | None = None) -> Decision:
        """Return the first step of the cheapest plan found.

        node_limit : replay a decision whose time box fired after so many nodes
        Raises : DataError when the forecast or the reference is no number
        """
        begun = time.perf_counter()
        settings = self._settings
        problem = planning_problem(
            context, self._model, settings.weight, settings.horizon, settings.preview, settings.tail
        )
        # Last minute's plan, one step on, is nearly the optimum: the search begins with a low bound.
        warm = shift_plan(self._previous, context)
        solution = solve(problem, settings.node_budget, settings.time_box(), node_limit, warm)
        plan = solution.plan
        self._previous = Previous(context.now_s, plan.levels, plan.fan)
        temps = problem.temperatures(plan.levels, plan.fan)
        why = {
            **cost_split(problem, plan.levels / HEATER_LEVELS, plan.fan, temps),
            **_search_facts(solution),
            "binding": binding(problem, plan, temps),
            "runner_up": runner_up(plan, solution.runner_up),
            "reference_c": problem.reference.tolist() if settings.preview else float(problem.reference[0]),
            "model": f"{self._model.name} {self._model.version}",
            "solve_ms": round(1e3 * (time.perf_counter() - begun), 3),
        }
        forecast = tuple(temps[: problem.horizon].tolist())
        return Decision(first_command(plan), self.name, forecast, why, planned_inputs(plan))


def planning_problem(
    context: Context, model: Arx, weight: float, horizon: int, preview: bool, tail: int = 0
) -> PlanningProblem:
    """Return the context as a planning problem.

    tail : steps after the horizon that count too, at the duty that would hold the reference and with the fan
        still: a plan is judged by what it leaves behind (a terminal cost; Mayne et al., Automatica 36, 2000)

    The inputs enter the forecast linearly at a known temperature. A fan that enters by the excess over the
    room is taken at one excess for the whole horizon, halfway between the present one and the reference's:
    were it weaker later than now it would always be worth to wait with it, and at the present one alone a
    fan beside a heater that starts cold would seem to cost nothing. A history shorter than the model needs
    is taken as if its oldest row had lasted.
    """
    steps, estimate, limits = horizon + tail, context.estimate, context.limits
    reference = goal_ahead(context, steps, preview)
    controls = np.zeros((1, steps, 2))
    # The tail drives what would hold the goal, so that a plan cannot gain by leaving the box cold.
    held = model.duty_to_hold(float(reference[-1]), estimate.temp_ambient, estimate.offset)
    controls[:, horizon:, 0] = min(held, limits.heater_max_duty)
    ahead = {
        "temp_ambient": np.full(steps, estimate.temp_ambient),
        "offset": np.full(steps, estimate.offset),
    }
    free = model.rollout(pad(context.history, model.rows_needed), controls, ahead)[0]
    heater, fan = model.responses(steps)
    if model.fan_input == "excess":
        fan = fan * (0.5 * (context.history["temp_air"][-1] + reference[0]) - estimate.temp_ambient)
    hottest = (free + np.cumsum(np.maximum(heater, 0.0))).max()
    return PlanningProblem(
        free=free,
        heater=heater,
        fan=fan,
        reference=reference,
        tail=tail,
        heater_weight=weight if context.penalty.heater is None else context.penalty.heater,
        fan_weight=weight if context.penalty.fan is None else context.penalty.fan,
        heater_levels=levels_allowed(limits.heater_max_duty),
        fan_rules=FanRules(
            on=context.last_sent.fan_at_end,
            hold=min(max(limits.fan_hold_steps, 0), horizon),
            min_on=max(limits.fan_min_on_steps, 1),
            min_off=max(limits.fan_min_off_steps, 1),
        ),
        temp_max=limits.temp_air_max_c,
        limit_weight=0.0 if hottest <= limits.temp_air_max_c else LIMIT_WEIGHT,
    )


def pad(history: Columns, rows: int) -> Columns:
    """Return a history of at least so many rows, extended by its oldest row with all outputs off."""
    missing = rows - len(history["temp_air"])
    if missing <= 0:
        return history
    before = {key: column[0] for key, column in history.items()} | {"heater_duty": 0.0, "fan_on": 0.0}
    return {key: np.concatenate([np.full(missing, value), history[key]]) for key, value in before.items()}


def shift_plan(previous: Previous | None, context: Context) -> tuple[Ints, Ints] | None:
    """Return the last plan shifted to the present, its last inputs held."""
    if previous is None:
        return None
    steps = round((context.now_s - previous.now_s) / context.step_s)
    if not 0 < steps < len(previous.levels):
        return None
    kept = np.minimum(np.arange(len(previous.levels)) + steps, len(previous.levels) - 1)
    return previous.levels[kept], previous.fan[kept]


def _search_facts(solution: Solution) -> dict[str, Any]:
    return {
        "bound": solution.bound,
        "gap": solution.gap,
        "proven": solution.proven,
        "nodes": solution.nodes,
        "time_box_fired": solution.time_box_fired,
    }
