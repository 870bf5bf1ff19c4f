"""Explanation of a plan: costs, constraints, the runner-up, the first command."""

from edge.controllers.mixed_integer.problem import Ints, Plan, PlanningProblem
from edge.core.controller import Floats
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS


def cost_split(problem: PlanningProblem, duty: Floats, fan: Ints, temps: Floats) -> dict[str, float]:
    """Split a plan's cost into its parts."""
    heater = float(problem.heater_weight * (duty**2).sum())
    fan_cost = float(problem.fan_weight * fan.sum())
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
        "fan_on": command.fan_on,
        "cost_more": other.cost - plan.cost,
    }


def first_command(plan: Plan) -> Command:
    """Return the plan's command for the step that begins now."""
    return Command(heater_duty=int(plan.levels[0]) / HEATER_LEVELS, fan_on=bool(plan.fan[0]))


def planned_inputs(plan: Plan) -> tuple[tuple[float, float], ...]:
    """Heater duty and fan of each step, as `Decision.plan` has them."""
    return tuple(zip((plan.levels / HEATER_LEVELS).tolist(), map(float, plan.fan), strict=True))
