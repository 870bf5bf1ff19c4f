"""A TickRecord as plain JSON values: one form for telemetry, the control socket and the display."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from edge.core.messages import Command, Drift, Echo, Event, Forecast, ForecastSkill, TickRecord
from edge.core.names import SIGNALS
from edge.core.plain_text import storable

TEMP_DIGITS, WIDTH_DIGITS = 2, 3  # of forecasts: a tenth of the sensor's resolution, a hundredth


def number(value: float | None, digits: int = 4) -> float | None:
    """`value` rounded, or None where JSON has no number for it (None, NaN, infinity)."""
    if value is None or not math.isfinite(value):
        return None
    return round(value, digits)


def json_value(value: Any) -> Any:
    """`value` as JSON can carry it: no NaN, no infinity, storable texts, no types of numpy's."""
    if isinstance(value, Mapping):
        return {storable(str(key)): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, str):
        return storable(value)
    if value is None or isinstance(value, int):
        return value
    return json_value(value.tolist()) if hasattr(value, "tolist") else str(value)


def command_json(command: Command) -> dict[str, Any]:
    """Return a command with units in its keys."""
    return {
        "heater_duty": number(command.heater_duty),
        "fan_on": int(command.fan_on),
        "fan_share": number(command.fan),
        "led": number(command.led),
        "valve_pulse_s": number(command.valve_pulse_s),
    }


def event_json(event: Event) -> dict[str, Any]:
    """Return an event; `utc` in seconds since 1970."""
    return {
        "key": event.key,
        "severity": event.severity.value,
        "text": event.text,
        "utc": number(event.utc, 3),
    }


def echo_json(echo: Echo | None) -> dict[str, Any] | None:
    """Return the board's outputs, None where it did not report them."""
    if echo is None:
        return None
    return {
        "heater_duty": number(echo.heater_duty),
        "fan_on": int(echo.fan_on),
        "fan_share": number(echo.fan),
        "led": number(echo.led),
        "valve_open": int(echo.valve_open),
        "tripped": int(echo.tripped),
        "trip_cause": echo.trip_cause,
    }


def forecast_json(forecast: Forecast) -> dict[str, Any]:
    """One predictor's forecast, by horizon in minutes; `outside` is null where it is not known."""
    return {
        "temp_c": {str(m): number(value, TEMP_DIGITS) for m, value in forecast.temps.items()},
        "half_width_k": {str(m): number(value, WIDTH_DIGITS) for m, value in forecast.half_widths.items()},
        "outside": None if forecast.outside is None else int(forecast.outside),
        "reason": forecast.reason,
    }


def skill_json(skill: Sequence[ForecastSkill]) -> dict[str, Any]:
    """By predictor: its version and, by horizon in minutes, how it does."""
    found: dict[str, Any] = {}
    for row in skill:
        of_predictor = found.setdefault(row.predictor, {"version": row.version, "horizons": {}})
        of_predictor["horizons"][str(row.horizon_min)] = {
            "scored": row.scored,
            "mae_k": number(row.mae_k),
            "against_persistence": number(row.against_persistence),
            "against_pbm": number(row.against_pbm),
            "half_width_k": number(row.half_width_k),
            "covered": number(row.covered),
        }
    return found


def drift_json(drift: Drift | None) -> dict[str, Any] | None:
    """Return the drift monitor's verdict, None without one. Times in seconds since 1970."""
    if drift is None:
        return None
    return {
        "state": drift.state.value,
        "text": drift.text,
        "reason": drift.reason,
        "since_utc": number(drift.since_utc, 3),
        "where": drift.where,
        "error_k": number(drift.error_k),
        "evidence": number(drift.evidence, 3),
        "learnt": number(drift.learnt, 3),
        "regimes": {
            name: {
                "ticks": number(row.ticks, 1),
                "share_of_squares": number(row.share_of_squares, 3),
                "error_k": number(row.error_k),
            }
            for name, row in drift.regimes.items()
        },
    }


def tick_json(record: TickRecord) -> dict[str, Any]:
    """Return the record without its skill and drift (`skill_json`,
    `drift_json`); a missing number is null.
    """
    return {
        "seq": record.seq,
        "utc": number(record.utc, 3),
        "step_s": record.step_s,
        "mode": record.mode,
        "readings": {
            SIGNALS[name].key: {"value": number(reading.value), "quality": reading.quality.value}
            for name, reading in record.readings.items()
        },
        "estimate": {
            "temp_air_c": number(record.estimate.temp_air),
            "temp_air_sd_k": number(record.estimate.temp_air_sd),
            # In six places: an offset is thousandths of a kelvin a step.
            "offset_k_per_step": number(record.estimate.offset, 6),
            "innovation_k": number(record.estimate.innovation),
            "temp_ambient_c": number(record.estimate.temp_ambient),
        },
        "reference_c": number(record.reference_c),
        "controller": record.decision.controller,
        "forecast_c": [number(value) for value in record.decision.forecast],
        "why": json_value(record.decision.why),
        "forecasts": {name: forecast_json(forecast) for name, forecast in record.forecasts.items()},
        "wanted": command_json(record.wanted),
        "sent": command_json(record.sent),
        "changes": [
            {
                "rule": change.rule,
                "actuator": change.actuator,
                "wanted": number(change.wanted),
                "sent": number(change.sent),
                "reason": change.reason,
            }
            for change in record.changes
        ],
        "echo": echo_json(record.echo),
        "link_up": int(record.link_up),
        "events": [event_json(event) for event in record.events],
        "ticks_skipped": record.ticks_skipped,
        "late_s": number(record.late_s),
        "decide_ms": number(record.decide_ms),
    }
