"""A tick as a rig publishes it (`edge.formats.tick_json`), checked, as samples and events.

A rig may lie, so nothing of a payload becomes the name of a series: names are those of edge's signals,
actuators and predictors. Quantities that are not known here are left out, and named.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from edge.config.settings import PREDICTORS
from edge.core.horizons import HORIZONS_MIN
from edge.core.messages import EVENT_TEXT_MAX, ReadingQuality, Severity
from edge.core.names import SIGNALS
from edge.core.plain_text import plain, quote
from edge.formats.reader import DocumentError, parse_json
from fleet.ingest.spans import Refused
from fleet.numbers.series import SEQ, Samples, head

Note = Callable[[str], None]
Found = Iterator[tuple[str, float]]

PAYLOAD_MAX = 64 << 10  # [bytes]; a tick of the default daemon has 2 kB
ID = re.compile(r"[a-zA-Z0-9-]{1,64}")  # of a history; edge makes UUIDs
KEY_MAX = 64  # characters of an event's key
SEQ_MAX = 2**53  # larger numbers are not whole in VictoriaMetrics
VALUE_MAX = 1e9  # of any quantity
AHEAD_MAX_S = 3600.0  # a rig's clock before ours; VictoriaMetrics drops what is two days ahead
STEPS_MAX = 60  # of a controller's forecast: the longest horizon of the settings
EVENTS_MAX = 200  # of one tick

TOP = ("step_s", "reference_c", "link_up", "ticks_skipped", "late_s", "decide_ms")
COMMAND = ("heater_duty", "fan_on", "fan_share", "led", "valve_pulse_s")
SECTIONS = {
    "estimate": ("temp_air_c", "temp_air_sd_k", "offset_k_per_step", "innovation_k", "temp_ambient_c"),
    "wanted": COMMAND,
    "sent": COMMAND,
    "echo": ("heater_duty", "fan_on", "fan_share", "led", "valve_open", "tripped"),
}
# Texts and reasons: they stay in the rig's history. `rig` is of no payload of ours, and has to be right.
BESIDE = {"history_id", "seq", "is_resend", "utc", "rig", "mode", "controller", "why", "changes", "events"}
QUALITIES = {quality.value: code for code, quality in enumerate(ReadingQuality)}  # 0 is good
SIGNAL_KEYS = frozenset(signal.key for signal in SIGNALS.values())


@dataclass(frozen=True, slots=True)
class TickEvent:
    """An event of a tick. utc : None where the rig did not know it"""

    key: str
    severity: str
    text: str
    utc: float | None


@dataclass(frozen=True, slots=True)
class Tick:
    """A tick that may be stored. unknown : quantities that were left out, the first of them named"""

    rig: str
    history_id: str
    seq: int
    utc: float
    is_resend: bool
    samples: Samples
    events: tuple[TickEvent, ...]
    unknown: str


def parse_tick(rig: str, payload: bytes, oldest_utc: float, now_utc: float) -> Tick:
    """Return the tick of a payload of the topic `<rig>/history/tick`.

    oldest_utc : ticks before it are older than what VictoriaMetrics keeps
    Errors : Refused
    """
    body = parse_body(payload)
    if body.get("rig", rig) != rig:
        raise Refused("name", f"its payload says that it is {quote(body['rig'])}")
    history_id, seq = _identity(body)
    try:
        utc = _time(body.get("utc"), oldest_utc, now_utc)
        unknown: list[str] = []
        samples = tuple(_samples(body, seq, unknown.append))
        more = f" and {len(unknown) - 1} more" if len(unknown) > 1 else ""
        named = f"{unknown[0]}{more}" if unknown else ""
        resent = body.get("is_resend") == 1
        return Tick(rig, history_id, seq, utc, resent, samples, _events(body.get("events")), named)
    except Refused as error:
        raise Refused(error.reason, f"tick {seq}: {error}", history_id, seq) from None


def parse_body(payload: bytes) -> dict[str, Any]:
    """Return a payload's JSON object. Errors: Refused"""
    try:
        return parse_json(payload, most=PAYLOAD_MAX)
    except DocumentError as error:
        raise Refused("size" if len(payload) > PAYLOAD_MAX else "json", str(error)) from None


def _identity(body: Mapping[str, Any]) -> tuple[str, int]:
    history_id, seq = body.get("history_id"), body.get("seq")
    if not isinstance(history_id, str) or not ID.fullmatch(history_id):
        raise Refused("history", f"history_id: {quote(history_id)} is not a history's")
    if type(seq) is not int or not 0 < seq <= SEQ_MAX:
        raise Refused("seq", f"seq: {quote(seq)} is not a whole number from 1 to {SEQ_MAX}")
    return history_id, seq


def _time(value: Any, oldest_utc: float, now_utc: float) -> float:
    utc = _number(value, "utc", 1e12)
    if utc is None or not oldest_utc <= utc <= now_utc + AHEAD_MAX_S:
        raise Refused("time", f"utc: {quote(value)} is not between {oldest_utc:.0f} and an hour from now")
    return utc


def _samples(body: Mapping[str, Any], seq: int, unknown: Note) -> Found:
    """Yield every number of a tick; a null is not one."""
    yield head(SEQ), seq
    for name, value in body.items():
        if name in TOP:
            yield from _sample(name, value)
        elif name in SECTIONS:
            yield from _section(name, value, unknown)
        elif name in _SPECIAL:
            yield from _SPECIAL[name](value, unknown)
        elif name not in BESIDE:
            unknown(plain(name, 40))


def _sample(quantity: str, value: Any, **labels: str | int) -> Found:
    found = _number(value, quantity)
    if found is not None:
        yield head(quantity, **labels), found


def _section(name: str, values: Any, unknown: Note) -> Found:
    for key, value in _object(values, name).items():
        if key in SECTIONS[name]:
            yield from _sample(f"{name}_{key}", value)
        elif key != "trip_cause":
            unknown(plain(f"{name}.{key}", 40))


def _readings(values: Any, unknown: Note) -> Found:
    for key, reading in _object(values, "readings").items():
        if key not in SIGNAL_KEYS:
            unknown(plain(f"readings.{key}", 40))
            continue
        quality = _object(reading, key).get("quality")
        if quality not in QUALITIES:
            raise Refused("value", f"readings.{key}.quality: {quote(quality)} is not a quality")
        yield head(f"{key}_quality"), QUALITIES[quality]
        yield from _sample(key, reading.get("value"))


def _plan(values: Any, unknown: Note) -> Found:
    if not isinstance(values, list) or len(values) > STEPS_MAX:
        raise Refused("value", f"forecast_c: not a list of at most {STEPS_MAX}")
    for step, value in enumerate(values, start=1):
        yield from _sample("plan_c", value, step=step)


def _forecasts(values: Any, unknown: Note) -> Found:
    for predictor, forecast in _object(values, "forecasts").items():
        if predictor not in PREDICTORS:
            unknown(plain(f"forecasts.{predictor}", 40))
            continue
        for kind, value in _object(forecast, predictor).items():
            if kind == "outside":
                yield from _sample("forecast_outside", value, predictor=predictor)
            elif kind in ("temp_c", "half_width_k"):
                yield from _horizons(predictor, kind, _object(value, kind), unknown)


def _horizons(predictor: str, kind: str, values: Mapping[str, Any], unknown: Note) -> Found:
    for minutes, value in values.items():
        if minutes in _HORIZONS:
            yield from _sample(f"forecast_{kind}", value, predictor=predictor, horizon_min=minutes)
        else:
            unknown(plain(f"forecasts.{predictor}.{kind}.{minutes}", 40))


def _events(values: Any) -> tuple[TickEvent, ...]:
    if values is None:
        return ()
    if not isinstance(values, list) or len(values) > EVENTS_MAX:
        raise Refused("value", f"events: not a list of at most {EVENTS_MAX}")
    return tuple(_event(_object(value, "events")) for value in values)


def _event(value: Mapping[str, Any]) -> TickEvent:
    key, severity, said = (value.get(name) for name in ("key", "severity", "text"))
    if not isinstance(key, str) or not isinstance(said, str) or severity not in _SEVERITIES:
        raise Refused("value", f"events: {quote(value)} is not an event")
    utc = _number(value.get("utc"), "events.utc", 1e12)
    return TickEvent(plain(key, KEY_MAX), str(severity), plain(said, EVENT_TEXT_MAX), utc)


def _object(value: Any, key: str) -> Mapping[str, Any]:
    if value is None:  # the echo of a board that did not answer
        return {}
    if not isinstance(value, dict):
        raise Refused("value", f"{plain(key, 40)}: must hold keys and values, not {quote(value)}")
    return value


def _number(value: Any, key: str, most: float = VALUE_MAX) -> float | None:
    if value is None:
        return None
    if type(value) not in (int, float) or not -most <= value <= most:
        raise Refused("value", f"{key}: {quote(value)} is not a number of at most {most:g}")
    return float(value)


_SPECIAL = {"readings": _readings, "forecast_c": _plan, "forecasts": _forecasts}
_HORIZONS = frozenset(str(minutes) for minutes in HORIZONS_MIN)
_SEVERITIES = frozenset(severity.value for severity in Severity)
