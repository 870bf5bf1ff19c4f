"""Units of a stranger's columns, and how each becomes ours."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.formats import run_file

Floats = NDArray[np.float64]
TRUE, FALSE = ("true", "on", "yes", "high", "open"), ("false", "off", "no", "low", "closed")
TEMPERATURES = ("temp_air_c", "temp_ambient_c", "temp_air_second_c")
SHARES = (*run_file.SHARES, "door_open")
PERCENTS = ("rel_humidity_pct", "ambient_rel_humidity_pct")
TARGETS = (*TEMPERATURES, *SHARES, *PERCENTS, "co2_ppm", "solar_w_m2")
SMALL = {**dict.fromkeys(PERCENTS, 1.0), "solar_w_m2": 2.0}  # in percent, or W/m2, numbers are larger
INPUTS = ("heater_duty", "fan_on")  # known in every row, or held from the one before


@dataclass(frozen=True, slots=True)
class Unit:
    """to_ours : from numbers in it to ours; needs_full : whether the mapping must say what 1 is (`full`)"""

    name: str
    to_ours: Callable[[Floats, float], Floats]
    needs_full: bool = False


UNITS: Mapping[str, Unit] = {
    unit.name: unit
    for unit in (
        Unit("degC", lambda values, _: values),
        Unit("degF", lambda values, _: (values - 32.0) / 1.8),
        Unit("K", lambda values, _: values - 273.15),
        Unit("share", lambda values, _: values),
        Unit("percent", lambda values, _: values / 100.0),
        Unit("0..255", lambda values, _: values / 255.0),
        Unit("on/off", lambda values, _: values),
        Unit("of full", lambda values, full: values / full, needs_full=True),
        Unit("percent of humidity", lambda values, _: values),
        Unit("share of humidity", lambda values, _: 100.0 * values),
        Unit("ppm", lambda values, _: values),
        Unit("W/m2", lambda values, _: values),
        Unit("kW/m2", lambda values, _: 1000.0 * values),
    )
}
BY_TARGET: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(TEMPERATURES, ("degC", "degF", "K")),
    **dict.fromkeys(SHARES, ("share", "percent", "0..255", "on/off", "of full")),
    **dict.fromkeys(PERCENTS, ("percent of humidity", "share of humidity")),
    "co2_ppm": ("ppm",),
    "solar_w_m2": ("W/m2", "kW/m2"),
}


def truth(cell: str) -> float | None:
    """1 or 0 for a word that says so, else None."""
    word = cell.strip().lower()
    return 1.0 if word in TRUE else 0.0 if word in FALSE else None


def guess_unit(target: str, values: Floats, words: str) -> tuple[str, float | None, str]:
    """Guess a column's unit from the words of its name and its numbers; `full`
    for shares, and the reason ("" if sure).
    """
    most = float(np.nanmax(np.abs(values), initial=0.0))
    if target in TEMPERATURES:
        return _temperature(float(np.nanmedian(values)), words)
    if target not in SHARES:
        return _by_size(target, most)
    if most <= 1.0:
        return "share", None, ""
    if "%" in words or "pct" in words or "percent" in words:
        return "percent", None, ""
    if most <= 100.0 and " w " not in f" {words} ":
        return "percent", None, f"the largest value is {most:g}, so it is taken for percent"
    if most <= 255.0 and "pwm" in words:
        return "0..255", None, ""
    if most == 255.0:
        return "0..255", None, "the largest value is 255, so it is taken for 0..255"
    return "of full", most, f"the largest value, {most:g}, is taken for full: say what full is"


def _by_size(target: str, most: float) -> tuple[str, float | None, str]:
    """Return the first unit of a target, or its second where every number is too small for the first."""
    usual, *other = BY_TARGET[target]
    if other and most <= SMALL[target]:
        return other[0], None, f"no value is above {SMALL[target]:g}, so it is taken for {other[0]}"
    return usual, None, ""


def _temperature(middle: float, words: str) -> tuple[str, float | None, str]:
    parts = words.split()
    for unit, names in (
        ("degF", ("f", "degf", "fahrenheit")),
        ("K", ("k", "kelvin")),
        ("degC", ("c", "degc", "celsius")),
    ):
        if any(name in parts for name in names):
            return unit, None, ""
    if middle > 150.0:
        return "K", None, f"the middle value is {middle:.0f}, so it is taken for kelvin"
    if middle > 55.0:
        return "degF", None, f"the middle value is {middle:.0f}, so it is taken for Fahrenheit"
    return "degC", None, "no unit is given, so it is taken for degC"
