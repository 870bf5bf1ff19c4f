"""Conditions of a row in words: the fan is off, T - T_amb > 6 K, the heater has just switched on."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.rows import DAY_S, HOUR_S, Floats, Rows

Mask = NDArray[np.bool_]
JUST_SWITCHED = (1, 2, 5)  # rows
FIRST_ROWS = (10, 30)  # of a run
DUTY_EDGES = (0.0, 0.25, 0.5, 0.75, 1.0)
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)  # near which a continuous signal is split, at a round number
HOURS = 3  # of a part of the day
STEEP_K_MIN = 0.05  # the air rises or falls, else it is steady


class Condition(NamedTuple):
    """about : the signal, one only in a pair; where : in words; mask : [R]"""

    about: str
    where: str
    mask: Mask


def conditions(rows: Rows) -> list[Condition]:
    """All single conditions that hold in some rows and not in all."""
    every = [
        *_switch_conditions(rows),
        *_levels(rows),
        *_thresholds(rows),
        *_motion(rows),
        *_light(rows),
        *_times(rows),
    ]
    return [item for item in every if item.mask.any() and not item.mask.all()]


def _switch_conditions(rows: Rows) -> Iterator[Condition]:
    for actuator, values in (("heater", rows.duty), ("fan", rows.fan)):
        yield Condition(actuator, f"the {actuator} is on", values > 0.0)
        yield Condition(actuator, f"the {actuator} is off", values == 0.0)
    since = {
        ("heater", "on"): rows.heater_on_for,
        ("heater", "off"): rows.heater_off_for,
        ("fan", "on"): rows.fan_on_for,
        ("fan", "off"): rows.fan_off_for,
    }
    for (actuator, way), ago in since.items():
        for count in JUST_SWITCHED:
            first = "first row" if count == 1 else f"first {count} rows"
            yield Condition(actuator, f"the {actuator} has just gone {way} ({first})", ago < count)


def _levels(rows: Rows) -> Iterator[Condition]:
    for low, high in pairwise(DUTY_EDGES):
        yield Condition("heater", f"the duty is {low:g} to {high:g}", (rows.duty > low) & (rows.duty <= high))
        if 0.0 < low < 1.0:
            yield Condition("heater", f"the duty is above {low:g}", rows.duty > low)


def _thresholds(rows: Rows) -> Iterator[Condition]:
    signals = [("difference", "T - T_amb", rows.excess_k, "K"), ("room", "T_amb", rows.ambient, "degC")]
    if rows.rel_humidity is not None:
        signals.append(("rel_humidity", "the relative humidity", rows.rel_humidity, "%"))
    for about, name, values, unit in signals:
        edges = _round_edges(values)
        for edge in edges:
            for sign, mask in ((">", values > edge), ("<", values < edge)):
                yield Condition(about, f"{name} {sign} {edge:g} {unit}", mask)
        for low, high in pairwise(edges):
            mask = (values >= low) & (values <= high)
            yield Condition(about, f"{name} is {low:g} to {high:g} {unit}", mask)


def _round_edges(values: Floats) -> list[float]:
    """Near the quantiles, in steps of 1, 2 or 5 times a power of ten that resolve a tenth of the range."""
    low, high = np.nanquantile(values, [0.02, 0.98])
    if not high > low:
        return []
    power = 10.0 ** np.floor(np.log10((high - low) / 8.0))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= (high - low) / 12.0)
    return sorted({float(round(q / step) * step) for q in np.nanquantile(values, QUANTILES)})


def _motion(rows: Rows) -> Iterator[Condition]:
    slope = rows.slope_k_min
    yield Condition("motion", "the air rises", slope > STEEP_K_MIN)
    yield Condition("motion", "the air falls", slope < -STEEP_K_MIN)
    yield Condition("motion", "the air is steady", np.abs(slope) <= STEEP_K_MIN)


def _light(rows: Rows) -> Iterator[Condition]:
    if rows.light is not None:
        yield Condition("light", "the light is on", rows.light > 0.0)
        yield Condition("light", "the light is off", rows.light == 0.0)


def _times(rows: Rows) -> Iterator[Condition]:
    for count in FIRST_ROWS:
        yield Condition("begin", f"in the first {count} rows of a run", rows.row < count)
    if len(rows.names) > 1:
        for i, name in enumerate(rows.names):
            yield Condition("run", f"in {name}", rows.run == i)
    if rows.utc_s is None:
        return
    hour = (rows.utc_s % DAY_S) / HOUR_S
    for begin in range(0, 24, HOURS):
        where = f"between {begin:02d} and {begin + HOURS:02d} h UTC"
        yield Condition("hour", where, (hour >= begin) & (hour < begin + HOURS))
    day = ((rows.utc_s - rows.utc_s.min()) // DAY_S).astype(int)
    for count in np.unique(day):
        yield Condition("day", f"on day {count + 1}", day == count)
        if 0 < count < day.max():
            yield Condition("day", f"from day {count + 1} on", day >= count)
