"""The recorded tick at a time, and its explanation in sentences. No model of any kind is asked."""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.core.messages import Command, Decision, ReadingQuality, TickRecord
from edge.core.plain_text import plain
from edge.storage.run_rows import reading
from edge.storage.tick_rows import read_ticks


def reasons(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield the sentences for which `why` has values."""
    for tell in (_rule, _plan, _binding, _next_best, _values, _quote, _claims):
        yield from tell(why)


def _rule(why: Mapping[str, Any]) -> Iterator[str]:
    if "rule" in why:
        yield f"Its rule: {why['rule']}."


def _plan(why: Mapping[str, Any]) -> Iterator[str]:
    if "cost_tracking" in why:
        by = f" by {why['model']}" if "model" in why else ""
        parts = ", ".join(
            f"{part} {_number(why.get(f'cost_{part}'))}" for part in ("tracking", "heater", "fan")
        )
        yield f"Its plan costs {_number(why.get('cost'))}{by}: {parts}."
    if why.get("time_box_fired"):
        yield "The time limit ended its search."


def _binding(why: Mapping[str, Any]) -> Iterator[str]:
    if why.get("binding"):
        yield f"What bound it: {', '.join(why['binding'])}."


def _next_best(why: Mapping[str, Any]) -> Iterator[str]:
    other = why.get("runner_up")
    if other and "cost_more" in other:
        fan = "on" if other["fan_on"] else "off"
        yield (
            f"The next best began with heater {other['heater_duty']:.2f}, fan {fan}, "
            f"and costs {_number(other['cost_more'])} more."
        )


def _values(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield a policy's estimate of the value of its actions."""
    if "policy" in why:
        margin = (
            f", {_number(why['margin'])} more than the next best" if why.get("margin") is not None else ""
        )
        yield f"{why['policy']} takes that to be worth {_number(why.get('value'))}{margin}."


def _quote(why: Mapping[str, Any]) -> Iterator[str]:
    """Yield a language model's reason, marked as its own words."""
    if "rationale" in why:
        yield f'The language model said: "{why["rationale"]}"'


def _claims(why: Mapping[str, Any]) -> Iterator[str]:
    for claim in why.get("claims", ()):
        if claim.get("holds") is False:
            yield f'That does not hold: "{claim["text"]}" ({claim.get("against", "nothing bears it out")}).'


def _number(value: Any) -> str:
    """Format a number; a value that was NaN when recorded is null in the history."""
    if not isinstance(value, int | float):
        return "not known"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def explain(record: TickRecord, zone: tzinfo | None) -> list[str]:
    """Sentences, the command first, then what led to it in the order of the tick."""
    return list(_sentences(record, zone))


def _sentences(record: TickRecord, zone: tzinfo | None) -> Iterator[str]:
    begin = datetime.fromtimestamp(record.utc, zone)
    how = "confirmed by the board" if record.echo is not None else "which the board did not confirm"
    yield f"Tick {record.seq}, {begin:%Y-%m-%d %H:%M:%S}: sent {_command(record.sent)}, {how}."
    yield _sensor_text(record)
    yield from _decision_lines(record.decision, record.wanted, record.mode)
    for change in record.changes:
        who = "Standing orders" if change.rule.startswith("operator.") else "Safety"
        yield (
            f"{who} changed {change.actuator} from {change.wanted:g} to {change.sent:g}: "
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


def _command(command: Command) -> str:
    return f"heater {command.heater_duty:.2f}, fan {'on' if command.fan_on else 'off'}"


def _degrees(value: float, digits: int = 1) -> str:
    return "not known" if value != value else f"{value:.{digits}f} °C"


Json = dict[str, Any]


def why(path: str | Path, at_utc: float | None, zone: tzinfo | None) -> Json:
    """Why the command that held at `at_utc` was sent, or the newest one where it is None.

    Returns : `seq`, `utc`, and `lines` of text
    Errors : DataError when nothing is recorded there
    """
    try:
        with reading(path) as connection:
            seq = _seq(connection, at_utc)
            if seq is None:
                raise DataError(f"{path}: no tick is recorded {'before that time' if at_utc else 'yet'}")
            record = read_ticks(connection, [seq]).get(seq)
            if record is None:
                raise DataError(f"{path}: tick {seq} is damaged")
    except sqlite3.Error as error:
        raise DataError(f"{path}: {error}") from error
    try:
        lines = explain(record, zone)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:  # its reasons are free
        raise DataError(f"{path}: tick {seq} is damaged: {plain(str(error))}") from None
    if at_utc is not None and at_utc - record.utc > 2 * record.step_s:
        ago = _ago(at_utc - record.utc)
        lines.insert(0, f"Nothing is recorded at that time; the last tick before it was {ago} earlier.")
    return {"seq": seq, "utc": record.utc, "lines": lines}


def _seq(connection: sqlite3.Connection, at_utc: float | None) -> int | None:
    """Return the newest tick that the daemon recorded at or before a time.
    Imported runs have negative numbers.
    """
    before, values = ("", ()) if at_utc is None else ("AND utc <= ?", (at_utc,))
    row = connection.execute(
        f"SELECT seq FROM ticks WHERE seq > 0 {before} ORDER BY utc DESC, seq DESC LIMIT 1", values
    ).fetchone()
    return None if row is None else int(row[0])


def _ago(seconds: float) -> str:
    """Return a length of time in words, in the largest unit of which there are at least two."""
    for unit, length_s in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{seconds:.0f} seconds"
