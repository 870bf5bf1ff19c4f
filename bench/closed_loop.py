"""What the plans are worth on the plant: closed loop on the two-node box."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.instances import REFERENCES_C, STEP_S, box_context
from bench.two_node_box import TwoNodeBox
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.mpc import Mpc, MpcSettings
from edge.controllers.mpc_bfgs import MpcBfgs
from edge.messages import Command
from edge.models.arx import Arx
from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]
Policy = Callable[[Floats, Floats, Floats, float, int], Command]  # temps, inputs, state, reference, step
ROOM_C = 21.0
STEPS_PER_REFERENCE = 20
BEAM = 150
_NODE_BUDGET = 20_000


def policies(model: Arx, horizon: int, weight: float) -> dict[str, Policy]:
    """The controllers compared, by name."""
    exact = Mpc("MPC", model, MpcSettings(weight, horizon, _NODE_BUDGET, 0.25))
    paper = MpcBfgs("MPC-BFGS", model, weight, horizon)

    def by_model(controller: Mpc | MpcBfgs) -> Policy:
        return lambda temps, inputs, state, reference, step: (
            controller.decide(box_context(temps, inputs, ROOM_C, reference, STEP_S * step)).command
        )

    def clairvoyant(temps: Floats, inputs: Floats, state: Floats, reference: float, step: int) -> Command:
        return plan_on_box(state, reference, horizon, weight)

    return {"MPC": by_model(exact), "MPC-BFGS": by_model(paper), "clairvoyant": clairvoyant}


def closed_loop_cost(policy: Policy, weight: float, references: int, seed: int) -> float:
    """Cost of an episode of reference steps: the planner's own stage cost, with what the box really does."""
    box, rng = TwoNodeBox(), np.random.default_rng([seed, 7])
    state, temps, inputs, cost = np.full(2, ROOM_C), [ROOM_C], np.empty((0, 2)), 0.0
    for reference in np.repeat(rng.uniform(*REFERENCES_C, size=references), STEPS_PER_REFERENCE):
        command = policy(np.array(temps), inputs, state, float(reference), len(inputs))
        duty, fan = command.heater_duty, float(command.fan_on)
        state = box.step(state, duty, fan, ROOM_C, STEP_S)
        temps.append(float(state[0]))
        inputs = np.vstack([inputs, [duty, fan]])
        cost += float(stage_cost(state[0], reference, weight, duty, fan))
    return cost


def plan_on_box(state: Floats, reference: float, horizon: int, weight: float) -> Command:
    """First step of the best plan a beam finds on the box itself: no model error, no preview."""
    box = TwoNodeBox()
    duty = np.tile(np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS, 2)
    fan = np.repeat([0.0, 1.0], HEATER_LEVELS + 1)
    states, cost, first = state[None, :], np.zeros(1), np.zeros(1, dtype=int)
    for k in range(horizon):
        spread = np.broadcast_to(states[:, None, :], (len(states), len(duty), 2))
        after = box.step(spread, duty, fan, ROOM_C, STEP_S)
        total = (cost[:, None] + stage_cost(after[..., 0], reference, weight, duty, fan)).ravel()
        kept = np.argsort(total, kind="stable")[:BEAM]
        parent, choice = np.divmod(kept, len(duty))
        first = choice if k == 0 else first[parent]
        states, cost = after.reshape(-1, 2)[kept], total[kept]
    return Command(float(duty[first[0]]), bool(fan[first[0]]))


def stage_cost(temp: Floats, reference: float, weight: float, duty: Floats, fan: Floats) -> Floats:
    """The paper's cost of one step."""
    return np.asarray(TRACKING_WEIGHT * (reference - temp) ** 2 + weight * (duty**2 + fan))
