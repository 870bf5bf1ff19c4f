"""A controller's answer in JSON: what it must look like, and strictly nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.wire import Schema, read_object
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.core.plain_text import plain
from edge.formats.reader import DocumentError, read

RATIONALE_MAX = 1200  # characters that are kept
SNAP = 1e-6  # a duty this near a level is that level
# Named one by one: a grammar can hold a model to a list, not to a range.
DUTIES = [level / HEATER_LEVELS for level in range(HEATER_LEVELS + 1)]


@dataclass(frozen=True, slots=True)
class ModelAnswer:
    """Controls and what stands behind them."""

    command: Command
    rationale: str
    simulation: str  # id of the simulation it cites, "" without one
    rounded_from: float | None = None  # the duty as it was said, where it was no level


@dataclass(frozen=True, slots=True)
class SaidControls:
    """The answer as a model gives it."""

    heater_duty: float
    fan_on: bool
    rationale: str


@dataclass(frozen=True, slots=True)
class SimulatedControls(SaidControls):
    """The answer of a model that can simulate."""

    simulation: str = ""


def answer_schema(simulations: Mapping[str, Command] | None) -> Schema:
    """Return the JSON schema of the answer. A strict schema lists every property as required.

    simulations : first controls of those that it may cite, by id; None where nothing is simulated
    """
    first = list((simulations or {}).values())
    levels = sorted({command.heater_duty for command in first}) or DUTIES
    fans = sorted({command.fan_on for command in first}) or [False, True]
    properties: dict[str, Any] = {
        "heater_duty": {"type": "number", "enum": levels},
        "fan_on": {"type": "boolean"} | ({} if len(fans) > 1 else {"enum": fans}),
        "rationale": {"type": "string"},
    }
    if simulations is not None:
        properties["simulation"] = {"type": "string"} | ({"enum": list(simulations)} if simulations else {})
    return Schema(
        "controls",
        {
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
        },
    )


def read_answer(content: str | None, with_simulation: bool) -> ModelAnswer:
    """Read the answer in a model's last message: one JSON object, alone or in one fence.

    Errors : LlmFailure: malformed, wrong_schema or out_of_range
    """
    document = read_object(content)
    try:
        values = read(SimulatedControls if with_simulation else SaidControls, document)
    except DocumentError as error:
        raise LlmFailure("wrong_schema", str(error)) from None
    said = values.heater_duty
    if not 0.0 <= said <= 1.0:
        raise LlmFailure("out_of_range", f"heater_duty is {said:g}, not 0 to 1")
    duty = nearest_level(said)
    return ModelAnswer(
        command=Command(heater_duty=duty, fan_on=values.fan_on),
        rationale=plain(values.rationale, RATIONALE_MAX),
        simulation=plain(values.simulation, 40) if isinstance(values, SimulatedControls) else "",
        rounded_from=None if abs(said - duty) <= SNAP else said,
    )


def nearest_level(duty: float) -> float:
    """Round a heater duty to the board's steps of 1/20."""
    return round(duty * HEATER_LEVELS) / HEATER_LEVELS
