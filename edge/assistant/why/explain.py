"""Why a command was sent, told from what was recorded of the tick: no model of any kind is asked."""

from collections.abc import Iterator, Sequence
from datetime import datetime, tzinfo

from edge.assistant.why.reasons import reasons
from edge.core.messages import Command, Decision, ReadingQuality, TickRecord


def explain(record: TickRecord, zone: tzinfo | None) -> list[str]:
    """Sentences, the command first, then what led to it in the order of the tick."""
    return list(_sentences(record, zone))


def _sentences(record: TickRecord, zone: tzinfo | None) -> Iterator[str]:
    begin = datetime.fromtimestamp(record.utc, zone)
    sent = f"{_command(record.sent)}{_confirmation(record)}"
    yield f"Tick {record.seq}, {begin:%Y-%m-%d %H:%M:%S}: sent {sent}."
    yield _sensor_text(record)
    yield from _decision_lines(record.decision, record.wanted, record.mode)
    for change in record.changes:
        yield (
            f"{_who(change.rule)} changed {change.actuator} from {change.wanted:g} to {change.sent:g}: "
            f"{change.reason} ({change.rule})."
        )
    if not record.changes:
        yield "Safety changed nothing."
    for event in record.events:
        yield f"At that tick: {event.text} ({event.key})."


def _sensor_text(record: TickRecord) -> str:
    air, estimate = record.readings.get("temp_air"), record.estimate
    if air is None or air.value is None or air.quality is not ReadingQuality.GOOD:
        quality = "absent" if air is None else air.quality.value
        seen = f"The air temperature was not good ({quality}), by the estimate {_degrees(estimate.temp_air)}"
    else:
        seen = f"The air was measured at {_degrees(air.value)}, estimated at {_degrees(estimate.temp_air, 2)}"
    room = f"the room {_degrees(estimate.temp_ambient)}"
    return f"{seen}, {room}; the reference was {_degrees(record.reference_c)}."


def _decision_lines(decision: Decision, wanted: Command, mode: str) -> Iterator[str]:
    why, failure = decision.why, decision.why.get("failure", "no reason is known")
    if "instead_of" in why:
        yield f"{decision.controller} decided, since {why['instead_of']} did not: {failure}."
    elif decision.controller == "none":
        yield f"No controller decided: {failure}; what heats or blows stays off."
    if mode == "manual":
        yield f"The mode was manual: {_command(wanted)} stood by hand, whatever {decision.controller} wanted."
    elif decision.controller != "none":
        ordered = "" if mode == "auto" else f", in the mode {mode}"
        yield f"{decision.controller} wanted {_command(wanted)}{ordered}{_expecting(decision.forecast)}."
    yield from reasons(why)


def _expecting(forecast: Sequence[float]) -> str:
    if not forecast:
        return ""
    first, last = _degrees(forecast[0], 2), _degrees(forecast[-1], 2)
    return f" and expected {first} after the step, {last} after {len(forecast)} steps"


def _who(rule: str) -> str:
    return "Standing orders" if rule.startswith("operator.") else "Safety"


def _confirmation(record: TickRecord) -> str:
    return ", confirmed by the board" if record.echo is not None else ", which the board did not confirm"


def _command(command: Command) -> str:
    return f"heater {command.heater_duty:.2f}, fan {'on' if command.fan_on else 'off'}"


def _degrees(value: float, digits: int = 1) -> str:
    return "not known" if value != value else f"{value:.{digits}f} °C"
