"""Suggested controls tried on a predictor before one of them is chosen."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from edge.assistant.llm.answer import DUTIES, ModelAnswer, nearest_level
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.ledger import Ledger, ToolError
from edge.assistant.llm.wire import ToolSpec
from edge.controllers.mpc import pad
from edge.controllers.rollout_search import ahead_with_offset, forecast
from edge.core.controller import Context, Floats
from edge.core.errors import DataError
from edge.core.messages import Command
from edge.core.predictor import Predictor
from edge.formats.cross_check import Rule
from edge.formats.reader import DocumentError, read

NAME = "simulate"
MOVES = 3  # different controls in a set, as planners block their moves: more cost tokens and hardly help
DIGITS = 2  # of a temperature that is told: more are no knowledge, and cost tokens
SAME_K = 0.51 * 10.0**-DIGITS  # two rollouts of one predictor under the same inputs differ by no more


@dataclass(frozen=True, slots=True)
class Simulator:
    """A predictor from where the rig stands.

    horizon : longest plan [steps]
    offset : what the predictor misses per step by the estimator's word [K/step]; 0 for a model that is not
        the estimator's own
    """

    predictor: Predictor
    context: Context
    horizon: int
    offset: float = 0.0

    def temperatures(self, controls: Floats) -> Floats:
        """Air temperature after each of the controls [N, 2]: [N] [°C]. Raises : DataError naming the model"""
        context, steps = self.context, len(controls)
        ahead = {**ahead_with_offset(context, steps), "offset": np.full(steps, self.offset)}
        history = pad(context.history, self.predictor.rows_needed)
        temps: Floats = forecast(self.predictor, history, controls[None], ahead)[0]
        return temps


@dataclass(frozen=True, slots=True)
class SimulateArguments:
    """Arguments of a call: values for the first steps, the last of which holds for all later ones."""

    heater_duty: Annotated[tuple[Annotated[float, Rule(low=0.0, high=1.0)], ...], Rule(least=1)]
    fan_on: Annotated[tuple[bool, ...], Rule(least=1)]

    def controls(self, steps: int) -> list[tuple[float, bool]]:
        """Return duty and fan of each step."""
        duty, fan = self.heater_duty, self.fan_on
        return [(duty[min(step, len(duty) - 1)], fan[min(step, len(fan) - 1)]) for step in range(steps)]


class SimulateTool:
    """`simulate(heater_duty, fan_on)`: one set of controls a call, as many calls as there are exchanges."""

    def __init__(self, simulator: Simulator, targets: Floats) -> None:
        """`targets` [N >= horizon]: reference after each step [°C]."""
        self._simulator = simulator
        self._targets = targets
        steps, step_s = simulator.horizon, simulator.context.step_s
        numbers = {"type": "array", "minItems": 1, "maxItems": MOVES}
        self.spec = ToolSpec(
            NAME,
            f"Predicts the air temperature after each of the next {steps} steps of {step_s:g} s when these "
            f"controls are applied, with the model {simulator.predictor.name}. Each list has 1 to {MOVES} "
            "values, the first for the step that begins now; its last value holds for all later steps. Call "
            "it once for each set of controls that you consider.",
            {
                "type": "object",
                "properties": {
                    "heater_duty": {**numbers, "items": {"type": "number", "enum": DUTIES}},
                    "fan_on": {**numbers, "items": {"type": "boolean"}},
                },
                "required": ["heater_duty", "fan_on"],
                "additionalProperties": False,
            },
        )

    def call(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Simulate and return the steps, with duties rounded as the board does. Errors: ToolError"""
        controls = self._controls(arguments)
        try:
            temps = self._simulator.temperatures(controls)
        except DataError as error:
            raise ToolError(str(error)) from None
        errors = np.abs(temps - self._targets[: len(temps)])
        return {
            "heater_duty": controls[:, 0].tolist(),
            "fan_on": [bool(value) for value in controls[:, 1]],
            "temp_air_c": [round(value, DIGITS) for value in temps.tolist()],
            "target_c": self._targets[: len(temps)].tolist(),
            "mean_abs_error_k": round(float(errors.mean()), 4),
        }

    def excerpt(self, result: Mapping[str, Any]) -> dict[str, Any]:
        """Return the temperatures and their error; the controls and a target that stays are known."""
        target = {"target_c": result["target_c"]} if len(set(result["target_c"])) > 1 else {}
        return {name: result[name] for name in ("temp_air_c", "mean_abs_error_k")} | target

    def _controls(self, arguments: Mapping[str, Any]) -> Floats:
        try:
            asked = read(SimulateArguments, arguments)
        except DocumentError as error:
            raise ToolError(str(error)) from None
        steps = self._simulator.horizon
        if max(len(asked.heater_duty), len(asked.fan_on)) > steps:
            raise ToolError(f"heater_duty, fan_on: must hold at most {steps} values")
        return np.array([[nearest_level(duty), float(fan)] for duty, fan in asked.controls(steps)])


def first_controls(ledger: Ledger) -> dict[str, Command]:
    """Return the first controls of every simulation, by its id."""
    return {
        entry.id: Command(entry.result["heater_duty"][0], entry.result["fan_on"][0])
        for entry in ledger.entries
        if entry.tool == NAME
    }


def cited_forecast(answer: ModelAnswer, ledger: Ledger, simulator: Simulator) -> tuple[float, ...]:
    """Simulate an answer's controls again and return the temperatures behind it [°C].

    Errors : LlmFailure: uncited, where no call of this answer is named; unfaithful, where that call began
        with other controls or its result does not come out again
    """
    entry = ledger.find(answer.simulation)
    if entry is None or entry.tool != NAME:
        cited = repr(answer.simulation) if answer.simulation else "nothing"
        raise LlmFailure("uncited", f"the answer cites {cited}, which is no simulation it asked for")
    result, command, first = entry.result, answer.command, first_controls(ledger)[entry.id]
    if (first.heater_duty, first.fan_on) != (command.heater_duty, command.fan_on):
        begins, said = (f"heater {one.heater_duty:g}, fan {one.fan_on}" for one in (first, command))
        raise LlmFailure("unfaithful", f"{entry.id} begins with {begins}, not {said}")
    controls = np.column_stack([result["heater_duty"], np.array(result["fan_on"], dtype=float)])
    again = simulator.temperatures(controls)
    if not np.abs(again - np.array(result["temp_air_c"])).max() <= SAME_K:
        raise LlmFailure("unfaithful", f"{entry.id} simulated again comes out otherwise")
    return tuple(again.tolist())
