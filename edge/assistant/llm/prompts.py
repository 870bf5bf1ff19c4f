"""Prompts of a controlling model: the paper's prompt, the rig, the form of the answer."""

from edge.assistant.llm import simulate_tool, sql_tool
from edge.assistant.llm.ledger import RULE
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.controller import Context, Penalty
from edge.core.controller_names import LlmVariant
from edge.core.names import HEATER_LEVELS

EXACTLY = "It is important that the temperature in the greenhouse matches the target temperature exactly."
SPARE = (
    "Keep the temperature in the greenhouse close to the target temperature, and spare heater and fan: of "
    "controls that track almost equally well, choose those with less heating and without the fan."
)
_QUESTION = (  # paper, Large Language Model; there heater_duty is called heater_duty_cycle
    "What should the control values heater_duty and fan_on be set to in order to maintain a temperature of "
    "{target:.2f} degrees? The temperature now is {current:.2f} and the ambient temperature is {ambient:.2f} "
    "degrees."
)
_SQL = f"Ask the tool {sql_tool.NAME} how the temperature answered to heater and fan before you choose."
_SIMULATE = (
    f"Try several sets of controls with the tool {simulate_tool.NAME}, compare the results, and choose the "
    "best one. Your answer must begin with the first controls of a simulation that you asked for."
)
_FAN = {
    "exhaust": "the fan blows room air through the box, and so cools it towards the room's temperature",
    "stirring": "the fan stirs the air within the box and lets none in",
    "none": "this box has no fan, so fan_on changes nothing",
}


def system_prompt(variant: LlmVariant, context: Context, horizon: int) -> str:
    """Return the system prompt: the rig, its limits at this tick, the tools and the form of the answer."""
    parts = [
        "You choose the controls of a miniature greenhouse for one step. You can't act: you propose, a "
        "safety supervisor checks, and the board confirms what it does. So never write that you have "
        "switched or changed anything.",
        _rig(context),
        _limits(context),
        _tools(variant, horizon),
        RULE,
        _form(variant),
    ]
    return "\n\n".join(part for part in parts if part)


def question(variant: LlmVariant, context: Context) -> str:
    """Return the paper's prompt, with or without penalty, and the present outputs of the board."""
    estimate, last = context.estimate, context.last_sent
    asked = _QUESTION.format(
        target=float(context.reference[0]), current=estimate.temp_air, ambient=estimate.temp_ambient
    )
    driven = (
        f"The board now drives heater_duty {last.heater_duty:.2f} and the fan is "
        f"{'on' if last.fan_on else 'off'}."
    )
    aim = SPARE if variant.penalty else EXACTLY
    return "\n".join(line for line in (asked, aim, _operators_weights(context.penalty), driven) if line)


def _operators_weights(penalty: Penalty) -> str:
    """Return an operator's request in words, by the costs of the planning controllers; "" without one."""
    asked = [
        f"{weight:g} times {use}"
        for weight, use in ((penalty.heater, "heater_duty squared"), (penalty.fan, "1 while the fan is on"))
        if weight is not None
    ]
    if not asked:
        return ""
    tracking = f"{TRACKING_WEIGHT:g} times the squared error"
    return f"The operator asks that a step costs {tracking} plus {' plus '.join(asked)}: make that small."


def _rig(context: Context) -> str:
    return (
        f"heater_duty is 0 to 1 in steps of {1 / HEATER_LEVELS:g} (1 is {context.limits.heater_w:g} W). "
        f"fan_on is true or false; {_FAN[context.limits.fan_role]}. "
        f"One step lasts {context.step_s:g} s. All temperatures are in degC."
    )


def _limits(context: Context) -> str:
    limits = context.limits
    said = [
        f"Limits now: heater_duty at most {limits.heater_max_duty:.2f}",
        f"air temperature below {limits.temp_air_max_c:g} degC",
    ]
    if limits.fan_hold_steps > 0:
        state = "on" if context.last_sent.fan_on else "off"
        said.append(f"the fan's relay stays {state} for {limits.fan_hold_steps} more steps")
    return ", ".join(said) + "."


def _tools(variant: LlmVariant, horizon: int) -> str:
    if not variant.assistance:
        return ""
    return _SQL if variant.assistance == "sql" else f"{_SIMULATE} A simulation goes {horizon} steps ahead."


def _form(variant: LlmVariant) -> str:
    cites = variant.assistance not in ("", "sql")
    citation = ', "simulation": "<id of the simulation, as simulate-1>"' if cites else ""
    return (
        "Answer with one JSON object and nothing else: "
        f'{{"heater_duty": <number>, "fan_on": <true or false>, "rationale": "<why, in at most three '
        f'sentences>"{citation}}}'
    )
