"""Small formulas that stand in for effects which the library has no name for.

They compete with the named effects in the same search, so that an effect is named only where no formula of
what was recorded explains the runs better, and what has no name still gets an equation with units. What says
the same as a named effect (a constant, u, u², L, T - T_amb with the fan or without) is left to it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.nuisances import middle
from edge.diagnosis.trial import SizedTerm
from edge.twin.geometry import USUAL_HEATER_W
from edge.twin.model import DAY_S
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
HEAT_SD, READING_SD_K = (
    0.5,
    5.0,
)  # of a formula's root mean square: large for a box; share of the heater's power
LEAST_RMS = 1e-6
WARM, HOT = 0.4, 0.6  # of the way from the coldest to the hottest reading
SUNS_H = (4, 8, 12)  # lengths of what comes at an hour of the day
PREFIX = "~"  # of a formula's name among effects


@dataclass(frozen=True, slots=True)
class FormulaShape:
    """Q = a * text, or an error of the reading; a in `unit`.

    depends_on : as in diagnosis.json, strongest first
    """

    text: str
    unit: str
    depends_on: tuple[str, ...]
    of: Callable[[Columns], Floats]
    needs: tuple[str, ...] = ()
    of_reading: bool = False


def _shape(
    text: str, unit: str, depends_on: str, of: Callable[[Columns], Floats], needs: str = "", **more: bool
) -> FormulaShape:
    return FormulaShape(text, unit, tuple(depends_on.split()), of, tuple(needs.split()), **more)


def _sun(first: int, hours: int) -> Callable[[Columns], Floats]:
    """Half a sine from an hour of the day on."""
    return lambda c: (
        np.maximum(np.sin(np.pi * ((c["hour"] - first) % 24.0) / hours), 0.0)
        * ((c["hour"] - first) % 24.0 < hours)
    )


def shapes(
    warm: float = 28.0, hot: float = 32.0, usual: float = 25.0, room: float = 20.0
) -> tuple[FormulaShape, ...]:
    """All that are tried. warm, hot, usual, room : temperatures from which some of them count [°C]"""
    # Short ones alone, each with one number to fit: a long formula fits any gap and names nothing.
    return (
        _shape("u fan", "W", "heater_duty fan_on", lambda c: c["u"] * c["fan"]),
        _shape("u^2 fan", "W", "heater_duty fan_on", lambda c: c["u"] ** 2 * c["fan"]),
        _shape("u (T - T_amb)", "W/K", "heater_duty temp_air", lambda c: c["u"] * c["excess"]),
        _shape("u (T - T_amb)^2", "W/K2", "heater_duty temp_air", lambda c: c["u"] * c["excess"] ** 2),
        _shape(f"u max(T - {warm:g}, 0)", "W/K", "heater_duty temp_air",
               lambda c: c["u"] * np.maximum(c["T"] - warm, 0)),
        _shape(f"u max(T - {hot:g}, 0)", "W/K", "heater_duty temp_air",
               lambda c: c["u"] * np.maximum(c["T"] - hot, 0)),
        _shape("u t", "W/h", "time heater_duty", lambda c: c["u"] * c["t"]),
        _shape("u day", "W/d", "time heater_duty", lambda c: c["u"] * c["day"], "day"),
        _shape("fan", "W", "fan_on", lambda c: c["fan"]),
        _shape("fan (T - T_amb)^2", "W/K2", "fan_on temp_air", lambda c: c["fan"] * c["excess"] ** 2),
        _shape(f"fan max(T - {warm:g}, 0)", "W/K", "fan_on temp_air",
               lambda c: c["fan"] * np.maximum(c["T"] - warm, 0)),
        _shape("fan t (T - T_amb)", "W/K/h", "fan_on time", lambda c: c["fan"] * c["t"] * c["excess"]),
        _shape("fan hours of fan (T - T_amb)", "W/K/h", "fan_on time",
               lambda c: c["fan"] * c["worn"] * c["excess"]),
        _shape("fan day (T - T_amb)", "W/K/d", "fan_on time",
               lambda c: c["fan"] * c["day"] * c["excess"], "day"),
        _shape("|T - T_amb| (T - T_amb)", "W/K2", "temp_air", lambda c: np.abs(c["excess"]) * c["excess"]),
        _shape("(T - T_amb)^3", "W/K3", "temp_air", lambda c: c["excess"] ** 3),
        _shape(f"max(T - {warm:g}, 0)", "W/K", "temp_air", lambda c: np.maximum(c["T"] - warm, 0)),
        _shape(f"max(T - {hot:g}, 0)", "W/K", "temp_air", lambda c: np.maximum(c["T"] - hot, 0)),
        _shape(f"T - {usual:g}", "W/K", "temp_air", lambda c: c["T"] - usual),
        _shape(f"T_amb - {room:g}", "W/K", "temp_ambient", lambda c: c["room"] - room),
        _shape("t", "W/h", "time", lambda c: c["t"]),
        _shape("t (T - T_amb)", "W/K/h", "time temp_air", lambda c: c["t"] * c["excess"]),
        _shape("day", "W/d", "time", lambda c: c["day"], "day"),
        _shape("sin(day)", "W", "time", lambda c: np.sin(2 * np.pi * c["hour"] / 24), "hour"),
        _shape("cos(day)", "W", "time", lambda c: np.cos(2 * np.pi * c["hour"] / 24), "hour"),
        *(
            _shape(
                f"half a sine of the day, {first}..{(first + hours) % 24} h",
                "W", "time", _sun(first, hours), "hour",
            )
            for hours in SUNS_H
            for first in range(0, 24, hours // 2)
        ),
        _shape("RH - 50", "W/%", "rel_humidity", lambda c: c["RH"] - 50, "RH"),
        _shape("(RH - 50) (T - T_amb)", "W/%/K", "rel_humidity temp_air",
               lambda c: (c["RH"] - 50) * c["excess"], "RH"),
        _shape("max(RH - 60, 0)", "W/%", "rel_humidity", lambda c: np.maximum(c["RH"] - 60, 0), "RH"),
        _shape("max(RH - 75, 0)", "W/%", "rel_humidity", lambda c: np.maximum(c["RH"] - 75, 0), "RH"),
        _shape("fan (RH - 50)", "W/%", "rel_humidity fan_on", lambda c: c["fan"] * (c["RH"] - 50), "RH"),
        _shape("u (RH - 50)", "W/%", "rel_humidity heater_duty", lambda c: c["u"] * (c["RH"] - 50), "RH"),
        _shape("L (RH - 50)", "W/%", "light rel_humidity", lambda c: c["L"] * (c["RH"] - 50), "L RH"),
        _shape("L^2", "W", "light", lambda c: c["L"] ** 2, "L"),
        _shape("L fan", "W", "light fan_on", lambda c: c["L"] * c["fan"], "L"),
        _shape("L (T - T_amb)", "W/K", "light temp_air", lambda c: c["L"] * c["excess"], "L"),
        _shape("L u", "W", "light heater_duty", lambda c: c["L"] * c["u"], "L"),
        _shape("reading: u", "K", "heater_duty", lambda c: c["u"], of_reading=True),
        _shape("reading: u fan", "K", "heater_duty fan_on", lambda c: c["u"] * c["fan"], of_reading=True),
        _shape("reading: fan", "K", "fan_on", lambda c: c["fan"], of_reading=True),
        _shape("reading: t", "K/h", "time", lambda c: c["t"], of_reading=True),
        _shape("reading: day", "K/d", "time", lambda c: c["day"], "day", of_reading=True),
        _shape("reading: RH - 50", "K/%", "rel_humidity", lambda c: c["RH"] - 50, "RH", of_reading=True),
        _shape("reading: L", "K", "light", lambda c: c["L"], "L", of_reading=True),
    )  # fmt: skip


def formulas(
    runs: RunBatch, temps: Floats, step_s: float, heater_w: float = USUAL_HEATER_W
) -> dict[str, tuple[FormulaShape, SizedTerm]]:
    """By name, what these runs have the columns for and can tell from nothing.

    temps : [B, N + 1], the air without its reading's noise [°C]: with it a formula would explain that noise
    """
    columns = _columns(runs, temps, step_s)
    measured = runs.measured.T
    found = {}
    for shape in shapes(*_levels(runs)):
        if not set(shape.needs) <= set(columns):
            continue
        values = np.where(measured, shape.of(columns), 0.0)
        rms = float(np.sqrt(np.mean(values[measured] ** 2)))
        if rms > LEAST_RMS and np.ptp(values[measured]) > LEAST_RMS:
            sd = (READING_SD_K if shape.of_reading else HEAT_SD * heater_w) / rms
            found[PREFIX + shape.text] = (shape, SizedTerm(PREFIX + shape.text, values, sd, shape.of_reading))
    return found


def _levels(runs: RunBatch) -> tuple[float, float, float, float]:
    """Whole degrees: warm and hot for this box, and what it and its room usually have."""
    low, high = np.nanmin(runs.temp), np.nanmax(runs.temp)
    levels = (low + WARM * (high - low), low + HOT * (high - low), np.nanmedian(runs.temp))
    warm, hot, usual, room = (float(round(value)) for value in (*levels, np.nanmedian(runs.ambient)))
    return warm, max(hot, warm + 1.0), usual, room


def _columns(runs: RunBatch, temps: Floats, step_s: float) -> dict[str, Floats]:
    """[N, B] each: T in the middle of a row, hours since the run began, of fan in it, and of the day."""
    inside = middle(temps)
    hours = np.broadcast_to(np.arange(runs.fan.shape[1]) * step_s / 3600.0, runs.fan.shape)
    columns = {
        "u": runs.duty,
        "fan": runs.fan,
        "T": inside,
        "room": runs.ambient,
        "excess": inside - runs.ambient,
        "t": hours,
        "worn": np.cumsum(runs.fan, axis=1) * step_s / 3600.0,
    }
    for key, name in (("L", "light"), ("RH", "rel_humidity")):
        if name in runs.conditions:
            columns[key] = runs.conditions[name]
    if "utc" in runs.conditions:
        utc = runs.conditions["utc"]
        columns["hour"] = utc / 3600.0 % 24.0
        columns["day"] = (utc - utc.min()) / DAY_S
    return {name: np.ascontiguousarray(values.T) for name, values in columns.items()}
