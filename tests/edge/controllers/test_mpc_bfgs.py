import numpy as np
import pytest
from contexts import context

from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.controllers.mpc import planning_problem
from edge.controllers.mpc_bfgs import MpcBfgs, rounded_bfgs
from edge.core.controller import ControlLimits
from edge.core.messages import Command
from edge.models.arx_file import read_arx

MODEL = read_arx()


def test_the_first_step_is_the_optimum_within_the_bounds_rounded():
    problem = planning_problem(context(22.0, 24.0), MODEL, 1.0, 1, False)
    duty, fan = np.meshgrid(np.linspace(0.0, 1.0, 2001), np.linspace(0.0, 1.0, 101))
    temps = problem.free[0] + problem.heater[0] * duty + problem.fan[0] * fan
    cost = 10.0 * (temps - 24.0) ** 2 + duty**2 + fan**2
    best = np.unravel_index(np.argmin(cost), cost.shape)
    levels, fan_plan, _ = rounded_bfgs(problem)
    assert 0.0 < duty[best] < 1.0
    assert levels[0] == round(20.0 * duty[best])
    assert fan_plan[0] == fan[best] == 0.0


def test_within_the_bounds_no_heat_is_hoped_for_from_a_fan_below_0():
    problem = planning_problem(context(26.0, 27.0), MODEL, 1.0, 10, False)
    (bounded, fan, _), (clipped, _, _) = (rounded_bfgs(problem, bounds) for bounds in (True, False))
    assert bounded[0] > 2 * clipped[0]
    assert problem.cost(bounded, fan) < problem.cost(clipped, fan)


@pytest.mark.parametrize("temp", [15.0, 21.0, 24.0, 30.0, 45.0])
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_plans_are_on_the_grid_and_never_better_than_the_exact_one(temp, weight):
    problem = planning_problem(context(temp, 26.0), MODEL, weight, 6, False)
    levels, fan, _ = rounded_bfgs(problem)
    assert problem.allows(levels, fan)
    exact = solve(problem, 100_000, TimeBox(1e9))
    assert float(problem.cost(levels, fan)) >= exact.bound


def test_what_is_sent_keeps_the_cap_and_the_hold():
    limits = ControlLimits(heater_max_duty=0.2, fan_hold_steps=1)
    decision = MpcBfgs("MPC-BFGS", MODEL, 0.0, 5).decide(context(21.0, 35.0, Command(fan_on=True), limits))
    assert decision.command == Command(heater_duty=0.2, fan_on=True)


def test_the_same_context_gives_the_same_decision():
    controller = MpcBfgs("MPC-BFGS-P", MODEL, 1.0, 5)
    one, two = controller.decide(context()), controller.decide(context())
    assert (one.command, one.forecast) == (two.command, two.forecast)


def test_without_a_penalty_no_fan_works_against_the_heater():
    problem = planning_problem(context(24.0, 28.0), MODEL, 0.0, 10, False)
    levels, fan, _ = rounded_bfgs(problem)
    assert levels[0] > 0
    assert not fan.any()
