"""MPC over the ARX, exact and by BFGS."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from contexts import context

from edge.app.controllers import ControllerParts, make
from edge.config.settings import ControlSettings
from edge.controllers.mixed_integer.solver import solve
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.controllers.mpc import Mpc, MpcSettings, planning_problem
from edge.controllers.mpc_bfgs import MpcBfgs, rounded_bfgs
from edge.core.controller import ControlLimits, Penalty
from edge.core.controller_names import MPC, RULES
from edge.core.errors import DataError, RequestError
from edge.core.messages import Command
from edge.models.arx_file import read_arx
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin

MODEL = read_arx()


def mpc(weight: float = 0.0, horizon: int = 8, budget: int = 100_000, preview: bool = False) -> Mpc:
    return Mpc("MPC", MODEL, MpcSettings(weight, horizon, budget, 1e9, preview))


def test_a_cold_box_is_heated_and_a_hot_one_cooled():
    assert mpc().decide(context(21.0, 30.0)).command.heater_duty > 0.5
    hot = mpc().decide(context(35.0, 22.0)).command
    assert hot.fan_on
    assert hot.heater_duty == 0.0


def test_the_forecast_is_the_models_own_rollout_of_the_plan():
    here = context(24.0, 27.0, Command(0.3, True), offset=0.05)
    controller = mpc(horizon=3)
    decision = controller.decide(here)
    assert len(decision.forecast) == 3
    assert decision.why["cost"] == pytest.approx(10.0 * sum((27.0 - t) ** 2 for t in decision.forecast))
    controls = np.zeros((1, 3, 2))
    controls[0, 0] = decision.command.heater_duty, decision.command.fan_on
    ahead = {"temp_ambient": np.full(3, 21.0), "offset": np.full(3, 0.05)}
    first = MODEL.rollout(here.history, controls, ahead)[0, 0]
    assert decision.forecast[0] == pytest.approx(first)


def test_a_disturbance_estimate_moves_the_plan():
    warm = mpc().decide(context(26.0, 26.0, Command(0.3), offset=0.05)).command.heater_duty
    cold = mpc().decide(context(26.0, 26.0, Command(0.3), offset=-0.05)).command.heater_duty
    assert warm < cold


def test_penalties_spare_the_actuators():
    free = mpc(0.0).decide(context(26.0, 24.0, Command(0.3))).why
    paying = mpc(1.0).decide(context(26.0, 24.0, Command(0.3))).why
    assert free["cost_fan"] == free["cost_heater"] == 0.0
    assert paying["cost"] == pytest.approx(
        paying["cost_tracking"] + paying["cost_heater"] + paying["cost_fan"]
    )
    assert paying["cost_tracking"] >= free["cost_tracking"]


def test_only_the_first_reference_counts_without_preview():
    coming = [24.0] * 3 + [32.0] * 57
    held = mpc().decide(context(24.0, 24.0))
    assert mpc().decide(context(24.0, coming)).forecast == held.forecast
    assert mpc(preview=True).decide(context(24.0, coming)).forecast != held.forecast


def test_limits_are_kept():
    limits = ControlLimits(heater_max_duty=0.42, fan_hold_steps=2)
    decision = mpc().decide(context(21.0, 35.0, Command(fan_on=True), limits))
    assert decision.command == Command(heater_duty=0.4, fan_on=True)
    assert "heater at its upper limit" in decision.why["binding"]
    assert "fan held on by its relay" in decision.why["binding"]


def test_the_soft_limit_is_stronger_than_the_reference():
    limited = mpc().decide(context(27.0, 33.0, limits=ControlLimits(temp_air_max_c=28.0)))
    assert max(limited.forecast) < 28.2  # a little over is cheaper than 5 K off the reference
    assert max(mpc().decide(context(27.0, 33.0)).forecast) > 30.0


def test_every_why_is_json_and_complete():
    for name in ("MPC", "MPC-P", "MPC-BFGS", "MPC-BFGS-P"):
        decision = make(name, ControllerParts(ControlSettings(), MODEL)).decide(context())
        why = json.loads(json.dumps(decision.why, allow_nan=False))
        for key in (
            "cost",
            "cost_tracking",
            "cost_heater",
            "cost_fan",
            "binding",
            "runner_up",
            "model",
            "solve_ms",
        ):
            assert key in why, (name, key)
        assert decision.controller == name
        assert MODEL.version in why["model"]
    assert {"bound", "gap", "proven", "nodes", "time_box_fired"} <= mpc().decide(context()).why.keys()


def test_the_runner_up_costs_more_and_begins_otherwise():
    decision = mpc().decide(context())
    other = decision.why["runner_up"]
    assert other["cost_more"] >= 0.0
    assert (other["heater_duty"], other["fan_on"]) != (decision.command.heater_duty, decision.command.fan_on)


def test_the_same_run_gives_the_same_decisions_bit_for_bit():
    def run():
        controller = mpc(1.0, budget=300)
        decisions = [
            controller.decide(context(20.0 + 0.3 * k, 23.0, now_s=60.0 * k, offset=0.01 * k))
            for k in range(10)
        ]
        return [
            (d.command, d.forecast, {k: v for k, v in d.why.items() if k != "solve_ms"}) for d in decisions
        ]

    assert run() == run()


def test_a_plan_is_carried_on_and_forgotten_on_reset():
    controller = mpc(1.0, budget=1, horizon=10)
    best = mpc(1.0, horizon=10).decide(context(24.0, 22.0)).why["cost"]
    alone = controller.decide(context(24.0, 22.0)).why["cost"]
    assert alone >= best
    controller.reset()
    assert controller.decide(context(24.0, 22.0)).why["cost"] == alone


@pytest.mark.parametrize(
    ("box_s", "decision_s", "wall_s"), [(0.25, 4.0, 0.75), (2.0, 4.0, 3.2), (2.0, 1.0, 2.0)]
)
def test_a_time_box_ends_before_the_decision_is_late(monkeypatch, box_s, decision_s, wall_s):
    """Three times the CPU time, at most four fifths of the deadline, and never below the CPU time."""
    found = []
    monkeypatch.setattr("edge.controllers.mpc.TimeBox", lambda cpu_s, wall_s: found.append((cpu_s, wall_s)))
    MpcSettings(1.0, 20, 100, box_s, decision_s=decision_s).time_box()
    assert found == [(box_s, pytest.approx(wall_s))]


def test_a_fired_time_box_is_reported_and_replayed():
    boxed = Mpc("MPC-P", MODEL, MpcSettings(1.0, 20, 100_000, 0.0))
    fired = boxed.decide(context(26.0, 22.0))
    assert fired.why["time_box_fired"]
    replayed = mpc(1.0, 20).decide(context(26.0, 22.0), node_limit=fired.why["nodes"])
    assert replayed.command == fired.command
    assert replayed.forecast == fired.forecast
    assert replayed.why["time_box_fired"]


@pytest.mark.parametrize("rows", [1, 2, 3, 120])
def test_any_length_of_history_will_do(rows):
    assert mpc().decide(context(21.0, 30.0, rows=rows)).command.heater_duty > 0.5


@pytest.mark.parametrize("here", [context(np.nan), context(24.0, np.nan), context(24.0, offset=np.nan)])
def test_a_forecast_that_is_no_number_is_refused(here):
    for name in ("MPC", "MPC-P", "MPC-BFGS"):
        with pytest.raises(DataError):
            make(name, ControllerParts(ControlSettings(), MODEL)).decide(here)


def test_a_preview_shorter_than_the_horizon_is_refused():
    with pytest.raises(DataError, match="reference: 3 steps"):
        mpc(preview=True).decide(context(24.0, [25.0, 25.0, 25.0]))


def test_every_name_makes_its_controller():
    for name in (RULES, *MPC):
        assert make(name, ControllerParts(ControlSettings(), MODEL)).name == name


def test_an_unknown_name_gets_the_nearest_known():
    with pytest.raises(RequestError, match=r"no 'MCP-P'; did you mean 'MPC-P'\?"):
        make("MCP-P", ControllerParts(ControlSettings(), MODEL))


def test_an_mpc_decides_without_scipy():
    script = (
        "import sys; sys.path.insert(0, 'tests/support')\n"
        "from contexts import context\n"
        "from edge.app.controllers import ControllerParts, make\n"
        "from edge.models.arx_file import read_arx\n"
        "from edge.core.controller_names import MPC\n"
        "from edge.config.settings import ControlSettings\n"
        "made = {name: make(name, ControllerParts(ControlSettings(), read_arx())) for name in MPC}\n"
        "made['MPC-P'].decide(context())\n"
        "assert not [name for name in sys.modules if name.startswith('scipy')]\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_an_operators_penalty_takes_the_place_of_the_names():
    dear = replace(context(30.0, 26.0), penalty=Penalty(fan=1e6))
    for name in ("MPC", "MPC-P"):
        controller = make(name, ControllerParts(ControlSettings(), MODEL))
        assert controller.decide(context(30.0, 26.0)).command.fan_on
        assert not controller.decide(dear).command.fan_on
    free = replace(context(30.0, 26.0), penalty=Penalty(heater=0.0, fan=0.0))
    by_name = make("MPC", ControllerParts(ControlSettings(), MODEL)).decide(context(30.0, 26.0))
    assert make("MPC-P", ControllerParts(ControlSettings(), MODEL)).decide(free).command == by_name.command


@pytest.mark.parametrize("name", ["MPC-P", "MPC-BFGS-P", "MPC-Twin-P"])
def test_the_configured_weight_is_that_of_the_names_with_penalty_alone(name):
    cold = replace(context(22.0, 24.0), reference=np.full(40, 24.0))
    parts = [
        ControllerParts(ControlSettings(penalty_weight=weight), MODEL, predictors={"pbm": Pbm(BoxTwin())})
        for weight in (0.0, 1e6)
    ]
    free, dear = (make(name, one).decide(cold).command for one in parts)
    assert free.heater_duty > 0.0
    assert dear.heater_duty == 0.0
    assert make(name.removesuffix("-P"), parts[1]).decide(cold).command.heater_duty > 0.0


@pytest.mark.parametrize("name", ["MPC", "MPC-BFGS", "MPC-BFGS-P"])
def test_the_setting_preview_reaches_every_mpc_over_the_arx(name):
    coming = context(24.0, [24.0] * 3 + [32.0] * 57)
    held, known = (
        make(name, ControllerParts(ControlSettings(preview=preview), MODEL)).decide(coming)
        for preview in (False, True)
    )
    assert held.why["reference_c"] == 24.0
    assert known.why["reference_c"][2:4] == [24.0, 32.0]
    assert held.forecast != known.forecast


# by BFGS


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
