"""Boxes of the chamber with something hidden that matters by as much as is wanted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.cases import HiddenEffect
from bench.hidden_effects.chamber_box import (
    OUTSIDE,
    SETTINGS,
    THIN_WALLS,
    Setting,
    Settings,
    draw_base,
    draw_known,
    draw_sign,
)
from bench.hidden_effects.chamber_calibration import read_off
from bench.hidden_effects.chamber_runs import RunPlan, believed_c
from bench.hidden_effects.equations_box import are_alike
from bench.hidden_effects.equations_inputs import Floats
from bench.hidden_effects.equations_search import strength_for

OPTIONAL = {
    "heater_lag": 0.3, "fan_effectiveness": 0.4, "soil_mass": 0.25, "infiltration": 0.25,
    "heater_efficiency": 0.25, "sensor_lag": 0.2, "constant_heat": 0.1, "led_gain": 0.1,
}  # fmt: skip
BARE_OPTIONAL = {
    **OPTIONAL, "ambient_offset": 0.15, "sensor_bias": 0.1, "heater_sag": 0.1, "heater_saturation": 0.1,
    "heater_deadtime": 0.1,
}  # fmt: skip
MOST_OPTIONAL = 2
GRID, GRID_RUNS, GRID_ROWS = 5, 2, 100  # runs and rows that a strength is searched on
CHECKED_RUNS = 3  # the last ones, tests among them
GLOWING = {"radiative_split", "sensor_radiation"}  # the element radiates, so its lag is not one number
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ChamberBox:
    """Settings of a box, what of it is hidden, and the settings of a box without that, for a calibration."""

    known: tuple[str, ...]
    settings: Settings
    calibration: Settings
    hidden: tuple[HiddenEffect, ...] = ()
    outside: HiddenEffect | None = None


def hide(
    rng: Generator, plans: Sequence[RunPlan], names: tuple[str, ...], wanted: Range
) -> ChamberBox | None:
    """Draw a box with these effects hidden, each of a size in `wanted`; None if it fails."""
    known, base = draw_known_box(rng, set(names))
    own: dict[str, Settings] = {}
    for name in names:
        found = _size(rng, SETTINGS[name], {**base, **_merge(own)}, plans, wanted)
        if found is None:
            return None
        own[name] = found
    return _check(known, base, own, plans, wanted)


def hide_outside(rng: Generator, plans: Sequence[RunPlan], name: str, wanted: Range) -> ChamberBox | None:
    """Draw a box with an effect of the chamber that no library knows."""
    known, base = draw_known_box(rng, {name})
    found = _size(rng, OUTSIDE[name][0], base, plans, wanted)
    if found is None:
        return None
    box = _check(known, base, {name: found}, plans, wanted)
    if box is None:
        return None
    effect = HiddenEffect(name, {key: float(value) for key, value in found.items()}, box.hidden[0].size_k)
    return ChamberBox(known, box.settings, base, (), effect)


def hide_all(rng: Generator, plans: Sequence[RunPlan], wanted: Range) -> ChamberBox | None:
    """Draw a box of 3 to 6 effects of which nothing is known."""
    names = ["wall_loss" if rng.random() < 0.5 else "wall_mass", "extra_capacity"]
    odds = np.array(list(BARE_OPTIONAL.values()))
    for name in rng.choice(list(BARE_OPTIONAL), rng.integers(1, 5), replace=False, p=odds / odds.sum()):
        if not are_alike({str(name), *names}):
            names.append(str(name))
    if len(names) < 3:
        return None
    base = draw_base(rng)
    return _check((), base, {name: draw_known(rng, name) for name in names}, plans, wanted)


def draw_pair(rng: Generator, first: str) -> tuple[str, ...]:
    """Return the first effect and another unlike it."""
    rest = [name for name in SETTINGS if name != first and not are_alike({first, name})]
    return first, str(rng.choice(rest))


def draw_known_box(rng: Generator, hidden: set[str]) -> tuple[tuple[str, ...], Settings]:
    """Names and settings of what is known."""
    names = [_way_out(rng, hidden), "extra_capacity"]
    names += ["infiltration"] if "evapotranspiration" in hidden else []  # else the box is soon full of vapour
    wanted = [name for name, odds in OPTIONAL.items() if rng.random() < odds]
    rng.shuffle(wanted)
    names += [name for name in wanted[:MOST_OPTIONAL] if _fits(name, hidden, names)]
    names = [name for name in names if name not in hidden]
    settings = draw_base(rng)
    if {"wall_loss", "longwave_radiation"} & hidden:
        settings |= {**THIN_WALLS, "cover.outer_film_w_m2_k": rng.uniform(2.0, 4.0)}
    for name in names:
        settings |= draw_known(rng, name)
    if "wall_loss" in hidden:
        settings["effects.longwave_radiation"] = rng.uniform(0.4, 0.7)
    if "wall_loss" in names and "longwave_radiation" in hidden:
        settings["cover.outer_film_w_m2_k"] = rng.uniform(2.0, 4.0)
    return tuple(names), settings


def _way_out(rng: Generator, hidden: set[str]) -> str:
    if "wall_loss" in hidden:
        return "longwave_radiation"
    if {"wall_mass", "longwave_radiation"} & hidden:
        return "wall_loss"
    return "wall_mass" if "radiative_split" in hidden or rng.random() < 0.5 else "wall_loss"


def _fits(name: str, hidden: set[str], names: Sequence[str]) -> bool:
    if name in names or name in hidden or are_alike({name, *hidden}):
        return False
    return name != "heater_lag" or not GLOWING & hidden


def _merge(own: dict[str, Settings]) -> Settings:
    return {key: value for settings in own.values() for key, value in settings.items()}


def _size(
    rng: Generator, setting: Setting, base: Settings, plans: Sequence[RunPlan], wanted: Range
) -> Settings | None:
    """Find the strength with the wanted size on a few rows."""
    few = [plan.shorten(GRID_ROWS) for plan in plans[-GRID_RUNS:]]
    sign, grid = draw_sign(rng), np.geomspace(setting.low, setting.high, GRID)
    without = _runs(base, few)
    sizes = np.array([_rms(_runs({**base, **setting.at(s, sign)}, few), without) for s in grid])
    strength = strength_for(rng, grid, sizes, wanted)
    return None if strength is None else setting.at(strength, sign)


def _check(
    known: tuple[str, ...],
    base: Settings,
    own: dict[str, Settings],
    plans: Sequence[RunPlan],
    wanted: Range,
) -> ChamberBox | None:
    """Return the box if each hidden effect matters as wanted among the others, over the last runs."""
    settings, last = {**base, **_merge(own)}, plans[-CHECKED_RUNS:]
    whole = _runs(settings, last) if own else np.zeros(0)
    true = read_off(list(own), settings)
    found = []
    for name in own:
        left = _merge({key: item for key, item in own.items() if key != name})
        kept = {"effects.wall_loss": 1.0} if name == "wall_mass" else {}
        size = _rms(whole, _runs({**base, **left, **kept}, last))
        if not wanted[0] <= size <= wanted[1]:
            return None
        found.append(HiddenEffect(name, true.get(name, {}), round(size, 4)))
    return ChamberBox(known, settings, base, tuple(sorted(found, key=lambda item: -item.size_k)))


def _runs(settings: Settings, plans: Sequence[RunPlan]) -> Floats:
    return np.concatenate([believed_c(settings, plan) for plan in plans])


def _rms(one: Floats, other: Floats) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))
