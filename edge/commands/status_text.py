"""The answer to `status` as a page that a person reads."""

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from edge.assistant.why.reasons import reasons

CLEAR_TRIP = "`greenhouse clear-trip` when the cause is gone"
# Stops that the board still holds and the daemon does not know of.
ENDED_BY = {
    "emergency_stop": "`greenhouse release` ends it",
    "maintenance": "`greenhouse maintenance 0` ends it",
}

Json = Mapping[str, Any]


def status_lines(status: Json) -> list[str]:
    """Return the lines: alarms first, then what was measured, what the board drives and who decides."""
    operation, tick = status["operation"], status["tick"]
    lines = list(_alarms(status))
    if tick is None:
        return [*lines, "no tick has been made yet"]
    at = datetime.fromtimestamp(tick["utc"])
    rows = {
        "air": _reading(tick, "temp_air_c"),
        "reference": f"{_degrees(tick['reference_c'])}, {_reference_from(operation)}",
        "room": _reading(tick, "temp_ambient_c"),
        **_output_texts(status["echo"]),
        "mode": f"{operation['mode']}, fan {operation['fan_mode']}",
        "controller": _decider(tick, operation),
        "asked": operation["steering"] and operation["steering"]["words"],
        "safety": "; ".join(dict.fromkeys(change["reason"] for change in tick["changes"])),
        "last tick": f"{tick['seq']} at {at:%H:%M:%S}, every {tick['step_s']:g} s",
        "why": "" if _is_stopped(operation, tick) else " ".join(reasons(tick["why"])),
    }
    return [*lines, *(f"{name:<11s}{text}" for name, text in rows.items() if text)]


def _alarms(status: Json) -> Iterator[str]:
    operation, tick, echo = status["operation"], status["tick"], status["echo"]
    if operation["emergency_stop"]:
        yield "EMERGENCY STOP: everything is off until `greenhouse release`"
    until = operation["maintenance_until_utc"]
    if _in_maintenance(operation, tick):
        yield f"MAINTENANCE until {datetime.fromtimestamp(until):%Y-%m-%d %H:%M}: everything is off"
    if status["trips"]:
        yield f"TRIPPED: {', '.join(map(str, status['trips']))}; {CLEAR_TRIP}"
    if echo is not None and echo["tripped"]:
        cause = echo["trip_cause"]
        known = {"emergency_stop": operation["emergency_stop"], "maintenance": until is not None}
        if not known.get(cause, False):
            yield f"THE BOARD HAS TRIPPED: {cause}; {ENDED_BY.get(cause, CLEAR_TRIP)}"
    if tick is not None and not status["link_up"]:
        yield "THE BOARD IS SILENT: it turns its heater off by itself"


def _in_maintenance(operation: Json, tick: Json | None) -> bool:
    until = operation["maintenance_until_utc"]
    return until is not None and (tick is None or tick["utc"] < until)


def _is_stopped(operation: Json, tick: Json) -> bool:
    """Return True while a person's stop holds everything off, so that no plan is carried out."""
    return bool(operation["emergency_stop"]) or _in_maintenance(operation, tick)


def _output_texts(echo: Json | None) -> dict[str, str]:
    if echo is None:
        return {"heater": "not known: the board does not say", "fan": "not known: the board does not say"}
    return {
        "heater": f"{echo['heater_duty']:.2f} of full power",
        "fan": "on" if echo["fan_on"] else "off",
        "LED": f"{echo['led']:.2f} of full light" if echo["led"] else "",
        "water valve": "open" if echo["valve_open"] else "",
    }


def _reading(tick: Json, key: str) -> str:
    reading = tick["readings"].get(key)
    if reading is None or reading["value"] is None:
        return f"not known ({'absent' if reading is None else reading['quality']})"
    return f"{_degrees(reading['value'])} ({reading['quality']})"


def _reference_from(operation: Json) -> str:
    if operation["reference_c"] is not None:
        return f"set by hand to {_degrees(operation['reference_c'])}"
    return "as asked for in words" if operation["steering"] else "as configured"


def _decider(tick: Json, operation: Json) -> str:
    chosen = str(operation["controller"])
    return chosen if tick["controller"] == chosen else f"{chosen}; {tick['controller']} decided the last step"


def _degrees(value: float | None) -> str:
    return "not known" if value is None else f"{value:.1f} °C"
