"""A steering and its effect in words: what the operator confirms is told by the values, not by a model."""

from collections.abc import Iterator, Mapping
from datetime import datetime, tzinfo
from typing import Any

from edge.tick.steering import Steering

_ROWS = {
    "temp_air_low_c": ("lowest air temperature", "°C"),
    "temp_air_high_c": ("highest air temperature", "°C"),
    "mean_error_k": ("mean error from its reference", "K"),
    "within_half_a_degree_pct": ("of the time within 0.5 K", "%"),
    "heat_wh": ("heat", "Wh"),
    "fan_min": ("fan", "min"),
}


def describe(steering: Steering, zone: tzinfo | None) -> list[str]:
    """One line for each thing that it changes, and its end."""
    return list(_lines(steering, zone))


def _lines(steering: Steering, zone: tzinfo | None) -> Iterator[str]:
    if steering.daily:
        targets = [f"{target.reference_c:g} °C from {_clock(target.from_s)}" for target in steering.daily]
        yield f"reference every day: {', '.join(targets)}"
    for what, penalty in (("heater", steering.heater_penalty), ("fan", steering.fan_penalty)):
        if penalty is not None:
            yield f"penalty of the {what}: {penalty:g}, for MPC-* and LLM-* (MPC-P has 1, MPC 0)"
    if steering.heater_max_duty is not None:
        yield f"heater duty at most {steering.heater_max_duty:g}"
    for rest in steering.fan_rest:
        yield f"fan off from {_clock(rest.from_s)} to {_clock(rest.until_s)}, unless safety needs it"
    until = datetime.fromtimestamp(steering.until_utc, zone)
    yield f"until {until:%Y-%m-%d %H:%M}, then as before"


def effect_table(effect: Mapping[str, Any]) -> list[str]:
    """Return the figures of the next day, without and with the steering.

    effect : `now` and `then`, both of `Course.figures`; or `reason`, why there are none
    """
    if "reason" in effect:
        return [f"no prediction: {effect['reason']}"]
    lines = [f"{'the next 24 h by the twin, room as now':<40s}{'as it is':>10s}{'then':>10s}"]
    for key, (label, unit) in _ROWS.items():
        lines.append(f"{label + ' [' + unit + ']':<40s}{effect['now'][key]:>10g}{effect['then'][key]:>10g}")
    return lines


def _clock(since_midnight_s: float) -> str:
    minutes = round(since_midnight_s / 60.0)
    return f"{minutes // 60:02d}:{minutes % 60:02d}"
