"""Plant of the MPC benchmark: a two-node box, planning problems on its fitted ARX, and closed loop on it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, PlanningProblem
from edge.controllers.mpc import Mpc, MpcSettings, planning_problem
from edge.controllers.mpc_bfgs import MpcBfgs
from edge.core.controller import Context, ControlLimits
from edge.core.messages import Command, Estimate
from edge.core.names import HEATER_LEVELS
from edge.formats.run_file import RecordedRun
from edge.models.arx import Arx, FanInput
from edge.models.fit_arx import ArxFit, fit_arx

Floats = NDArray[np.float64]
STEP_S = 60.0
RUNS, ROWS = 15, 212  # as many runs of as many minutes as the paper has
SENSOR_NOISE_K = 0.05
REFERENCES_C = (22.0, 34.0)
ROOM_C = 21.0
STEPS_PER_REFERENCE = 20
OFFSET_GAIN = 0.3  # share of a forecast error that is taken for a lasting disturbance
BEAM = 150
TAIL = 10  # as the daemon has it
_NODE_BUDGET = 20_000


@dataclass(frozen=True, slots=True)
class TwoNodeBox:
    """Heat balance of air and cover; the fan exchanges air with the room.

    C_air dT/dt = 100 W u_h - G_ac (T - T_c) - G_fan u_f (T - T_room)
    C_cover dT_c/dt = G_ac (T - T_c) - G_cr (T_c - T_room)
    """

    air_j_k: float = 500.0  # 0.15 m³ of air (181 J/K) and what follows it within a step
    cover_j_k: float = 3200.0  # 2.7 kg of polycarbonate at 1200 J/(kg K)
    air_cover_w_k: float = 13.6  # 1.7 m² at 8 W/(m² K)
    cover_room_w_k: float = 13.6
    fan_w_k: float = 15.5  # 68 m³/h at an effectiveness of 0.68
    heater_w: float = 100.0
    substeps: int = 6  # per control step: 10 s at 60 s

    def step(self, state: Floats, heater: Floats, fan: Floats, room: float, step_s: float) -> Floats:
        """State [..., 2] (air, cover) [°C] after `step_s` with inputs held (RK4)."""
        dt = step_s / self.substeps
        for _ in range(self.substeps):
            k1 = self._slope(state, heater, fan, room)
            k2 = self._slope(state + 0.5 * dt * k1, heater, fan, room)
            k3 = self._slope(state + 0.5 * dt * k2, heater, fan, room)
            k4 = self._slope(state + dt * k3, heater, fan, room)
            state = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return state

    def _slope(self, state: Floats, heater: Floats, fan: Floats, room: float) -> Floats:
        air, cover = state[..., 0], state[..., 1]
        to_cover = self.air_cover_w_k * (air - cover)
        to_room = self.fan_w_k * fan * (air - room)
        air_slope = (self.heater_w * heater - to_cover - to_room) / self.air_j_k
        cover_slope = (to_cover - self.cover_room_w_k * (cover - room)) / self.cover_j_k
        return np.stack(np.broadcast_arrays(air_slope, cover_slope), axis=-1)


def random_inputs(rng: np.random.Generator, rows: int, change: float) -> Floats:
    """[rows, 2], heater duty on its grid and fan, each changed with probability `change` at every step."""
    inputs = np.zeros((rows, 2))
    for k in range(rows):
        inputs[k] = inputs[k - 1] if k else (0.0, 0.0)
        if rng.random() < change:
            inputs[k, 0] = rng.integers(0, 21) / 20
        if rng.random() < change:
            inputs[k, 1] = rng.integers(0, 2)
    return inputs


def drive(box: TwoNodeBox, inputs: Floats, room: float) -> tuple[Floats, Floats]:
    """Air temperature before each row of inputs [rows], and the state after the last [2]; begun at `room`."""
    state, temps = np.full(2, room), np.empty(len(inputs))
    for k, (heater, fan) in enumerate(inputs):
        temps[k] = state[0]
        state = box.step(state, heater, fan, room, STEP_S)
    return temps, state


def fitted_model(seed: int, fan_input: FanInput = "on") -> ArxFit:
    """Fit the ARX model of order 3 with the ambient as an input."""
    rng, box = np.random.default_rng(seed), TwoNodeBox()
    runs = []
    for _ in range(RUNS):
        room = 21.0 + rng.normal(scale=0.5)
        inputs = random_inputs(rng, ROWS, 0.1)
        temps, _ = drive(box, inputs, room)
        noisy = temps + SENSOR_NOISE_K * rng.normal(size=ROWS)
        columns = {
            "time_s": STEP_S * np.arange(ROWS),
            "temp_air_c": noisy,
            "temp_ambient_c": np.full(ROWS, room),
            "heater_duty": inputs[:, 0],
            "fan_on": inputs[:, 1],
        }
        runs.append(RecordedRun(columns))
    return fit_arx(runs[:12], runs[12:], STEP_S, [(3, 3)], fan_input)


def instances(model: Arx, count: int, horizon: int, weight: float, seed: int) -> Iterator[PlanningProblem]:
    """Problems as they come up: an hour of random inputs, then any reference; the same for every horizon."""
    box = TwoNodeBox()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        room = 21.0 + rng.normal()
        inputs = random_inputs(rng, 60, 0.15)
        temps, state = drive(box, inputs, room)
        reference = rng.uniform(*REFERENCES_C)
        yield planning_problem(
            box_context(np.append(temps, state[0]), inputs, room, reference), model, weight, horizon, False
        )


def box_context(
    temps: Floats, inputs: Floats, room: float, reference: float, offset: float = 0.0, now_s: float = 0.0
) -> Context:
    """Return the context of a controller: temperatures [n + 1] and inputs
    [n, 2] so far, all known exactly.
    """
    last = Command(float(inputs[-1, 0]), bool(inputs[-1, 1])) if len(inputs) else Command()
    history = {
        "temp_air": temps,
        "temp_ambient": np.full(len(temps), room),
        "heater_duty": np.append(inputs[:, 0], np.nan),
        "fan_on": np.append(inputs[:, 1], np.nan),
    }
    estimate = Estimate(float(temps[-1]), 0.0, offset, None, room, now_s)
    return Context(now_s, now_s, STEP_S, history, estimate, np.full(60, reference), last, ControlLimits())


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
