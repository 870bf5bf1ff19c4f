"""Value of plans on the plant: closed loop on the two-node box."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.instances import REFERENCES_C, STEP_S, box_context
from bench.two_node_box import TwoNodeBox
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.mpc import Mpc, MpcSettings
from edge.controllers.mpc_bfgs import MpcBfgs
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.models.arx import Arx

Floats = NDArray[np.float64]
ROOM_C = 21.0
STEPS_PER_REFERENCE = 20
OFFSET_GAIN = 0.3  # share of a forecast error that is taken for a lasting disturbance
BEAM = 150
TAIL = 10  # as the daemon has it
_NODE_BUDGET = 20_000


@dataclass(slots=True)
class RecordedEpisode:
    """The box and what was recorded of it so far."""

    state: Floats  # air, cover [°C]
    temps: list[float]
    inputs: list[tuple[float, float]]
    offset: float = 0.0  # disturbance estimate [K/step]
    forecast: float | None = None  # air temperature that the last decision expected now [°C]


class Policy(Protocol):
    """Chooses the command for the next step."""

    def __call__(self, episode: RecordedEpisode, reference: float) -> Command:
        """May note its forecast in the episode."""
        ...


def by_model(controller: Mpc | MpcBfgs) -> Policy:
    """Return a controller as the loop would call it, with a disturbance estimate from its forecast errors."""

    def policy(episode: RecordedEpisode, reference: float) -> Command:
        if episode.forecast is not None:
            episode.offset += OFFSET_GAIN * (episode.temps[-1] - episode.forecast)
        inputs = np.array(episode.inputs).reshape(-1, 2)
        now_s = STEP_S * len(inputs)
        here = box_context(np.array(episode.temps), inputs, ROOM_C, reference, episode.offset, now_s)
        decision = controller.decide(here)
        episode.forecast = decision.forecast[0]
        return decision.command

    return policy


def policies(model: Arx, excess: Arx, horizon: int, weight: float) -> dict[str, Policy]:
    """Return the compared controllers by name. excess : a model whose fan acts on the excess over the room"""
    exact = MpcSettings(weight, horizon, _NODE_BUDGET, time_box_s=0.25)
    with_tail = replace(exact, tail=TAIL)
    return {
        "MPC": by_model(Mpc("MPC", model, exact)),
        "with fan by excess": by_model(Mpc("MPC", excess, exact)),
        f"and a tail of {TAIL}": by_model(Mpc("MPC", excess, with_tail)),
        "MPC-BFGS": by_model(MpcBfgs("MPC-BFGS", model, weight, horizon)),
        "clairvoyant": lambda episode, reference: plan_on_box(episode.state, reference, horizon, weight),
    }


def closed_loop_cost(policy: Policy, weight: float, references: int, seed: int) -> float:
    """Cost of an episode of reference steps: the planner's own stage cost, with what the box really does."""
    box, rng = TwoNodeBox(), np.random.default_rng([seed, 7])
    episode, cost = RecordedEpisode(np.full(2, ROOM_C), [ROOM_C], []), 0.0
    for reference in np.repeat(rng.uniform(*REFERENCES_C, size=references), STEPS_PER_REFERENCE):
        command = policy(episode, float(reference))
        duty, fan = command.heater_duty, float(command.fan_on)
        episode.state = box.step(episode.state, np.asarray(duty), np.asarray(fan), ROOM_C, STEP_S)
        episode.temps.append(float(episode.state[0]))
        episode.inputs.append((duty, fan))
        cost += float(stage_cost(episode.state[0], reference, weight, np.asarray(duty), np.asarray(fan)))
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
    """Return the paper's cost of one step."""
    return np.asarray(TRACKING_WEIGHT * (reference - temp) ** 2 + weight * (duty**2 + fan))
