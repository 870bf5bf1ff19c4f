"""Payloads of the live topics, made from the control loop's status."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge.core.names import SIGNALS
from edge.twin.draws import CORRELATION
from edge.twin.twin_file import read_twin_file, twin_document

Json = dict[str, Any]
TOLD = (CORRELATION, "after")  # of a twin's provenance: which values go together, how good it is

LINE_COUNTERS = {
    "bad_crc": "Frames with a wrong CRC",
    "not_understood": "Messages not understood",
    "retries": "Repeated requests",
    "given_up": "Requests given up",
    "greetings": "Greetings of the board",
}  # of firmware_protocol.link -> what they count


def state(status: Mapping[str, Any], counters: Mapping[str, int | None]) -> Json:
    """One flat object for Home Assistant's templates; what is not known is null, never 0.

    status : the answer to `{"do": "status"}`, with a tick in it; `line` holds the counters of the serial line
    counters : diagnostics of the daemon itself
    """
    tick, operation = status["tick"], status["operation"]
    echo = status["echo"]  # an order acts at once, so the board's outputs may be newer than the tick
    return {
        "seq": tick["seq"],
        "utc": tick["utc"],
        **_measurements(tick["readings"]),
        # The estimate beside the reading: it goes on when a reading is missing.
        "estimate_c": tick["estimate"]["temp_air_c"],
        "reference_c": _reference(tick, operation),
        "mode": operation["mode"],
        "emergency_stop": int(operation["emergency_stop"]),
        "maintenance": int(operation["maintenance_until_utc"] is not None),
        "fan_mode": operation["fan_mode"],
        "controller": operation["controller"],
        "manual_heater_duty": operation["manual"]["heater_duty"],
        "hvac_mode": _hvac_mode(operation),
        "action": _action(operation, echo),
        "heater_duty": echo and echo["heater_duty"],
        "fan_on": echo and echo["fan_on"],
        "led": echo and echo["led"],
        "valve_open": echo and echo["valve_open"],
        "link_up": status["link_up"],
        "tripped": int(_is_tripped(status)),
        "trips": ", ".join(_trips(status)),
        "problem": int(_has_problem(status)),
        "late_s": tick["late_s"],
        "decide_ms": tick["decide_ms"],
        **counters,
        **_line_counters(status.get("line")),
    }


def decision(status: Mapping[str, Any]) -> Json:
    """Return the wanted and the sent command, and the reason."""
    tick = status["tick"]
    keys = ("seq", "utc", "mode", "controller", "reference_c", "wanted", "sent", "changes", "why")
    return {key: tick[key] for key in keys}


def forecast(status: Mapping[str, Any]) -> Json:
    """Air temperature expected after each of the next steps of `step_s`, counted from `utc`."""
    tick = status["tick"]
    return {key: tick[key] for key in ("seq", "utc", "step_s", "reference_c", "forecast_c")}


def forecasts(status: Mapping[str, Any]) -> Json:
    """Air temperature that each predictor expects, and half widths of its interval, by horizon in minutes."""
    tick = status["tick"]
    return {key: tick[key] for key in ("seq", "utc", "step_s", "forecasts")}


def skill(status: Mapping[str, Any]) -> Json:
    """How each predictor does, by horizon in minutes; none of them before an hour of ticks."""
    tick = status["tick"]
    return {"seq": tick["seq"], "utc": tick["utc"], "predictors": status.get("skill", {})}


def drift(status: Mapping[str, Any]) -> Json:
    """Return whether the running twin agrees with the greenhouse; unknown where it is not watched."""
    tick = status["tick"]
    found = status.get("drift") or {"state": "unknown", "text": "the twin is not watched"}
    return {"seq": tick["seq"], "utc": tick["utc"], **found}


def twin(path: Path) -> Json:
    """Return the twin that runs, as its file has it; of its origin TOLD alone. Errors: DataError"""
    file = read_twin_file(path)
    told = {key: value for key, value in file.provenance.items() if key in TOLD}
    return {"bundle": path.parent.name, "twin": twin_document(replace(file, provenance=told))}


def _measurements(readings: Mapping[str, Any]) -> Json:
    """Values of good readings alone; a bad one is null and its quality says why."""
    values: Json = {}
    for signal in SIGNALS.values():
        reading = readings.get(signal.key, {"value": None, "quality": "absent"})
        values[signal.key] = reading["value"] if reading["quality"] == "good" else None
        values[f"{signal.name}_quality"] = reading["quality"]
    return values


def _reference(tick: Mapping[str, Any], operation: Mapping[str, Any]) -> float | None:
    """Return the reference: an order counts at once, the tick's own reference until then."""
    ordered: float | None = operation["reference_c"]
    return tick["reference_c"] if ordered is None else ordered


def _hvac_mode(operation: Mapping[str, Any]) -> str | None:
    """Return a mode that Home Assistant knows, null (unknown) in manual mode."""
    if operation["emergency_stop"]:
        return "off"
    return None if operation["mode"] == "manual" else operation["mode"]


def _action(operation: Mapping[str, Any], echo: Mapping[str, Any] | None) -> str | None:
    """From what the board really drives; null when it did not say."""
    if echo is None:
        return None
    if echo["heater_duty"] > 0:
        return "heating"
    if echo["fan_on"]:
        return "fan"
    return "off" if _hvac_mode(operation) == "off" else "idle"


def _line_counters(line: Mapping[str, int] | None) -> Json:
    """Return the counters. One that never counted is not in `line`; without
    `line` (a recorded board) none is known.
    """
    return {f"line_{key}": None if line is None else line.get(key, 0) for key in LINE_COUNTERS}


def _trips(status: Mapping[str, Any]) -> list[str]:
    echo = status["echo"]
    maintained = status["operation"]["maintenance_until_utc"] is not None  # asked for, so it is not a fault
    shown = echo and echo["tripped"] and not (maintained and echo["trip_cause"] == "maintenance")
    board = [echo["trip_cause"]] if shown else []
    return [str(trip) for trip in (*status["trips"], *board)]


def _is_tripped(status: Mapping[str, Any]) -> bool:
    return bool(_trips(status))


def _has_problem(status: Mapping[str, Any]) -> bool:
    """Return whether a person should look: tripped, no board, no
    confirmation, or no trustworthy air temperature.
    """
    tick = status["tick"]
    air = tick["readings"].get(SIGNALS["temp_air"].key)
    air_is_good = air is not None and air["quality"] == "good"
    return _is_tripped(status) or not status["link_up"] or status["echo"] is None or not air_is_good
