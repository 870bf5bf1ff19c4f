"""`MPC-Twin` and `MPC-Twin-P` as the daemon asks them."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contexts import context

from edge.app.active_models import ActiveModels
from edge.app.controllers import ControllerParts, make
from edge.config.settings import BundleSettings, ControlSettings, Settings
from edge.controllers.mpc_twin import HORIZON, LEAST_WEIGHT, TAIL, MpcTwin, fan_shares
from edge.controllers.twin_plan.linear_step import linear_step
from edge.controllers.twin_plan.rest import AHEAD_STEPS
from edge.core.controller import ControlLimits, Penalty
from edge.core.errors import ConfigError, DataError, RequestError
from edge.core.messages import Command
from edge.forecasts.skill import SkillState
from edge.models.arx_file import read_arx
from edge.models.pbm import Pbm, read_twin
from edge.safety.relay_proof import EVERY_S, RelayProof, follow
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

TWINS = {
    "diagnosed": Path("training/results/paper_case/interpolation/twin.yaml"),
    "packaged": Path("edge/models/default_bundle/twin.yaml"),
}


@pytest.fixture(params=TWINS)
def model(request) -> Pbm:
    return read_twin(TWINS[request.param])


def here(**what):
    made = context(**what)
    reference = np.full(120, made.reference[0])
    history = dict(made.history) | {"temp_air_measured": made.history["temp_air"]}
    return replace(made, reference=reference, history=history)


def test_a_cold_box_is_heated_and_a_hot_one_cooled(model):
    controller = MpcTwin("MPC-Twin-P", model, 1.0)
    assert controller.decide(here(temp=23.0, reference=27.0)).command.heater_duty > 0.5
    controller.reset()
    cooling = controller.decide(here(temp=30.0, reference=24.0)).command
    assert cooling.fan_on
    assert cooling.heater_duty < 0.3  # a whole minute of fan is more than is needed


def test_the_why_is_json_and_says_what_the_plan_costs(model):
    decision = MpcTwin("MPC-Twin", model, 0.0).decide(here())
    why = json.loads(json.dumps(decision.why))
    assert {
        "cost",
        "cost_tracking",
        "binding",
        "runner_up",
        "model",
        "solve_ms",
        "disturbance_k",
    } <= why.keys()
    assert len(decision.forecast) == len(decision.plan) == HORIZON


@pytest.mark.parametrize("duty", [0.0, 0.3, math.nan])
def test_the_heaters_limit_is_kept(model, duty):
    limits = ControlLimits(heater_max_duty=duty)
    command = MpcTwin("MPC-Twin", model, 0.0).decide(here(temp=22.0, reference=35.0, limits=limits)).command
    assert command.heater_duty <= (0.0 if math.isnan(duty) else duty + 1e-9)


def test_a_held_relay_stays_as_it_is(model):
    limits = ControlLimits(fan_hold_steps=1)
    assert not MpcTwin("MPC-Twin", model, 0.0).decide(here(temp=30.0, limits=limits)).command.fan_on


def test_it_goes_on_from_its_last_state_as_from_the_whole_history(model):
    """A tick later: one that was asked before knows what one knows that is asked for the first time."""
    before, now = here(temp=25.0, rows=30), here(temp=25.0, rows=31, now_s=60.0)
    sent = {key: np.zeros(31) for key in ("heater_duty", "fan_on")}
    now = replace(now, history={**now.history, **sent})
    asked, fresh = (MpcTwin("MPC-Twin-P", model, 1.0) for _ in range(2))
    asked.decide(before)
    assert asked.decide(now).command == fresh.decide(now).command


def test_a_history_without_a_temperature_is_refused(model):
    blind = here()
    nothing = {**blind.history, "temp_air_measured": np.full(10, np.nan)}
    with pytest.raises(DataError, match="no air temperature"):
        MpcTwin("MPC-Twin", model, 0.0).decide(replace(blind, history=nothing))


def test_a_reference_that_ends_too_soon_is_refused(model):
    with pytest.raises(DataError, match="reference"):
        MpcTwin("MPC-Twin", model, 0.0).decide(replace(here(), reference=np.full(5, 25.0)))


def test_the_registry_makes_it_of_the_bundles_twin():
    parts = ControllerParts(ControlSettings(), read_arx(), predictors={"pbm": Pbm(BoxTwin())})
    assert make("MPC-Twin-P", parts).name == "MPC-Twin-P"
    with pytest.raises(RequestError, match="twin of the active bundle"):
        make("MPC-Twin", ControllerParts(ControlSettings(), read_arx()))


def test_a_rig_without_a_twin_says_so_at_its_start_and_does_without_else():
    bare = Settings(bundle=BundleSettings(path=""))
    chosen = replace(bare, control=replace(bare.control, controller="MPC-Twin"))
    with pytest.raises(ConfigError, match="MPC-Twin plans with a bundle's twin"):
        ActiveModels(chosen, None, SkillState())
    others = ActiveModels(bare, None, SkillState()).controllers()
    assert "MPC-Twin" not in others
    assert {"rules", "PID", "MPC"} <= others.keys()


def test_without_preview_only_the_present_reference_counts(model):
    now, rising = here(temp=24.0, reference=24.0), np.repeat([24.0, 32.0], [3, 117])
    coming = replace(now, reference=rising)

    def forecast(what, preview):
        return MpcTwin("MPC-Twin", model, 0.0, preview).decide(what).forecast

    assert forecast(coming, False) == forecast(now, False) == forecast(now, True)
    assert forecast(coming, True) != forecast(now, True)


def test_a_weight_of_nothing_is_the_least_one():
    planner, reference = MpcTwin("MPC-Twin-P", Pbm(), 1.0), np.full(HORIZON + TAIL, 24.0)
    goal = planner._goal(replace(here(), penalty=Penalty(heater=0.0, fan=0.0)), reference, 0)
    assert goal.heater_weight == goal.fan_weight == LEAST_WEIGHT
    goal = planner._goal(replace(here(), penalty=Penalty(heater=2.0)), reference, 0)
    assert (goal.heater_weight, goal.fan_weight) == (2.0, 1.0)


def proven_run(model: Pbm, due_steps: int, knows: bool, steps: int = 26) -> float:
    """Cost of tracking where the twin is the box and the relay's proof is due after `due_steps`."""
    reference = np.full(steps + 60, 30.0)
    controller, room = MpcTwin("MPC-Twin-P", model, 1.0), 22.0
    state = at_rest(model.twin, 30.0, room)
    step = linear_step(model.twin, state, room, {}, fan_shares(60.0, ControlLimits()))
    air, duty, fan, sent, cost = [30.0], [], [], Command(), 0.0
    proof = RelayProof(since_s=EVERY_S - 60.0 * due_steps, heated_s=3000.0, fanned_s=3000.0)
    for k in range(steps):
        due_s = proof.due_in_s
        known = math.ceil(due_s / 60.0) if knows and math.isfinite(due_s) else None
        limits = ControlLimits(heater_max_duty=0.0 if proof.running else 1.0, proof_in_steps=known)
        made = context(temp=air[-1], rows=k + 1, now_s=60.0 * k, last_sent=sent, limits=limits)
        columns = {"temp_air": air, "temp_air_measured": air, "temp_ambient": [room] * (k + 1)}
        columns |= {"heater_duty": [*duty, math.nan], "fan_on": [*fan, math.nan]}
        history = {name: np.array(column)[-120:] for name, column in columns.items()}
        estimate = replace(made.estimate, temp_ambient=room)
        now = replace(made, history=history, estimate=estimate, reference=reference[k : k + 60])
        sent = Command() if proof.running else controller.decide(now).command
        share = sent.fan_share if sent.fan_on else 0.0
        before = (duty[-1], fan[-1]) if duty else (0.0, 0.0)
        mode = int(step.mode(np.array(int(before[1] >= 1.0)), np.array(step.place_of(share))))
        state = step.matrix[mode] @ state + step.constant[mode] + step.room[mode] * room
        state += step.now[mode] * step.share_of(sent.heater_duty) + step.late[mode] * step.share_of(before[0])
        air, duty, fan = [*air, float(state[step.shown])], [*duty, sent.heater_duty], [*fan, share]
        proof = follow(proof, 60.0, air[-1], sent.heater_duty > 0.0, share, quiet=False)
        cost += 10.0 * (air[-1] - reference[k]) ** 2
    assert not proof.running
    assert proof.since_s < 60.0 * steps
    return cost


@pytest.mark.slow
def test_it_is_ready_for_the_relays_proof():
    model = read_twin(TWINS["packaged"])
    known, unknown = (proven_run(model, 12, knows) for knows in (True, False))
    assert known < 0.8 * unknown


def test_a_rest_is_offered_where_the_reference_falls_and_is_over_where_the_proof_is(model):
    now = here(temp=30.0, reference=30.0)
    falling = replace(now, reference=np.repeat([30.0, 26.0], [5, 115]))
    planner = MpcTwin("MPC-Twin-P", model, 1.0)
    for due, asks in ((None, falling), (AHEAD_STEPS + 1, falling), (40, now)):
        planner.reset()
        plan = planner.decide(replace(asks, limits=ControlLimits(proof_in_steps=due))).plan
        assert plan == plan_without_proof(model, asks)
    planner.reset()
    plan = planner.decide(replace(now, limits=ControlLimits(proof_in_steps=3))).plan
    assert all(sent == (0.0, 0.0) for sent in plan[3:5])


def plan_without_proof(model: Pbm, asks):
    """Return the plan without any proof in sight."""
    return MpcTwin("MPC-Twin-P", model, 1.0).decide(asks).plan


def test_a_box_whose_heat_shows_late_is_heated_nonetheless():
    """Box 108 of bench/boxes: a mat far from the sensor, of which the first steps show nothing."""
    geometry = Geometry(volume_m3=0.31, heater_max_w=133.6, fan_max_m3_s=0.006)
    effects = {"wall_loss": {"UA": 10.0}, "extra_capacity": {"kC": 168.7}}
    effects |= {"imperfect_mixing": {"F_mix": 0.004}, "sensor_lag": {"tau_s": 96.6}}
    planner = MpcTwin("MPC-Twin-P", Pbm(BoxTwin(geometry, effects)), 1.0)
    decision = planner.decide(here(temp=19.9, reference=24.4))
    assert [duty for duty, _ in decision.plan[:10]] == [1.0] * 10
    assert decision.forecast[-1] > 20.2


@pytest.mark.parametrize(
    ("over_k", "duty", "waits"),
    [(0.8, 0.6, True), (0.8, 0.3, False), (1.2, 0.6, False)],
    ids=["heat that came between", "little heat", "far too warm"],
)
def test_the_fan_does_not_take_out_again_what_the_heater_has_just_brought(over_k, duty, waits):
    controller = MpcTwin("MPC-Twin-P", read_twin(TWINS["diagnosed"]), 1.0)
    history = {"heater_duty": np.zeros(31), "fan_on": np.zeros(31)}
    history["fan_on"][-5], history["heater_duty"][-4:-1] = 0.5, duty
    for minute in range(12):  # the first minutes after a start, or a step of the reference, are free
        now = here(temp=25.0 + over_k, reference=25.0, rows=31, now_s=60.0 * minute)
        decision = controller.decide(replace(now, history={**now.history, **history}))
    assert any(fan > 0.0 for _, fan in decision.plan[:6]) != waits
    assert (decision.command.fan > 0.0) != waits
