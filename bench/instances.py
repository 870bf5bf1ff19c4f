"""Planning problems for the MPC benchmark: an ARX model of order 3, fitted on runs of the two-node box."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bench.two_node_box import TwoNodeBox
from edge.controllers.mixed_integer.problem import PlanningProblem
from edge.controllers.mpc import planning_problem
from edge.core.controller import Context, ControlLimits
from edge.core.messages import Command, Estimate
from edge.formats.run_file import RecordedRun
from edge.models.arx import Arx, FanInput
from edge.models.fit_arx import ArxFit, fit_arx

Floats = NDArray[np.float64]
STEP_S = 60.0
RUNS, ROWS = 15, 212  # as many runs of as many minutes as the paper has
SENSOR_NOISE_K = 0.05
REFERENCES_C = (22.0, 34.0)


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
