"""The answer to *what if* in sentences: is the heater big enough, what is in the way, what is not known."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from edge.app.what_if import (
    BENT_MAX,
    HUMIDITY_PCT,
    SLOW_S,
    STORED_MAX,
    WALL_SHARE_MIN,
    Outlook,
    Quantity,
    Seen,
    TwinChange,
    WhatIf,
)
from edge.config.settings import Settings
from edge.twin.draws import CORRELATION, uncertain
from edge.twin.effects.library import nameless
from edge.twin.effects.named import heater_lag
from edge.twin.twin_file import TwinFile

SURE = 0.95  # share of the draws for a plain yes or no
SHORT_H = 12.0  # of a run; a box that is warmed for longer may have stores that the run does not show


@dataclass(frozen=True, slots=True)
class HeatLimits:
    """Limits by which a rig's safety turns heat off, and of its reference."""

    air_max_c: float
    reference_max_c: float
    duty_max: float
    hour_max_wh: float
    day_max_wh: float

    @classmethod
    def of(cls, settings: Settings) -> "HeatLimits":
        """Return those of a rig's settings."""
        safety = settings.safety
        return cls(
            safety.temp_air_max_c,
            settings.reference.max_c,
            safety.heater_max_duty,
            safety.energy_hour_max_wh,
            safety.energy_day_max_wh,
        )


def verdict(asked: WhatIf, now: Outlook, changed: Outlook | None, limits: HeatLimits) -> str:
    """Say whether the heater is big enough for the target, and in what time it gets there."""
    found, begin = (now, "") if changed is None else (changed, "With the change: ")
    target, room = f"{asked.target_c:g} °C", f"at a room of {asked.room_c:g} °C"
    if asked.target_c >= limits.air_max_c:
        return f"{begin}No: the safety limit of {limits.air_max_c:g} °C is below: heat is turned off there."
    if not found.power_w.high > 0.0:
        return f"{begin}Yes: {target} takes no heat {room}."
    takes = f"{target} takes {span(found.power_w, 'W')}"
    if found.sure >= SURE:
        way = f"; from {asked.start_c:g} °C it gets there in {span(found.warm_up_min, 'min')}"
        soon = way if asked.start_c < asked.target_c else ""
        return f"{begin}Yes: {takes} of the {found.heater_w:g} W {room}{soon}."
    reaches = f"at full heat the air reaches {span(found.reach_c, '°C')} {room}"
    needed_w = _as_sold(found.power_w.high / limits.duty_max) if limits.duty_max > 0.0 else math.nan
    would = f"{takes}; a heater of {needed_w:g} W would do"
    if found.sure <= 1.0 - SURE:
        return f"{begin}No: {reaches}. {would}."
    return f"{begin}Perhaps ({found.sure:.0%} of the twins that fit say yes): {reaches}. {would}."


def settings_in_the_way(asked: WhatIf, found: Outlook, limits: HeatLimits) -> Iterator[str]:
    """Yield settings that do not let the rig do what the physics would."""
    if limits.reference_max_c < asked.target_c < limits.air_max_c:
        yield f"A reference may be {limits.reference_max_c:g} °C at most (reference.max_c)."
    if found.reach_c.high >= limits.air_max_c:
        yield (
            f"The safety limit of {limits.air_max_c:g} °C is below what full heat may reach: heat is turned "
            "off there (safety.temp_air_max_c)."
        )
    if limits.duty_max < 1.0:
        yield f"Full heat is {limits.duty_max:.0%} of the heater (safety.heater_max_duty)."
    full_w = limits.duty_max * found.heater_w
    if found.power_w.high > limits.hour_max_wh:
        yield f"Safety allows {limits.hour_max_wh:g} W in the mean of an hour (safety.energy_hour_max_wh)."
    elif full_w * min(found.warm_up_min.high, 60.0) > 60.0 * limits.hour_max_wh:
        minutes = 60.0 * limits.hour_max_wh / full_w
        yield f"Safety allows {minutes:.0f} min of full heat in an hour (safety.energy_hour_max_wh)."
    if 1e3 * found.energy_kwh_day.high > limits.day_max_wh:
        yield f"Safety allows {1e-3 * limits.day_max_wh:g} kWh a day (safety.energy_day_max_wh)."


EXPERIENCE = (  # python -m bench.what_if at commit 02ed168c, new boxes
    "In 20 simulated boxes, each after tests of two hours, 153 of 165 intervals held: 52 of 55 of the air at "
    "full heat, 54 of 55 of the power, 47 of 55 of the time to the target."
)


def unknowns_of(file: TwinFile, asked: WhatIf, found: Outlook) -> Iterator[str]:
    """Yield what the twin does not know, and what is assumed in its place."""
    yield EXPERIENCE
    spreads, seen = uncertain(file), Seen.of(file)
    places = [("effects", name, key) for name, own in file.effects.items() for key in own]
    if exact := [".".join(place[1:]) for place in places if place not in spreads]:
        yield f"Taken as exact, as the twin's file has no interval: {', '.join(exact)}."
    if len(spreads) > 1 and CORRELATION not in file.provenance:
        yield "The twin's file has no correlations: its values are taken as independent of each other."
    yield from _of_rows(seen, max(found.reach_c.high, asked.target_c) - asked.room_c)
    if nameless(file.effects):
        yield (
            "The twin has heat of no known cause, maybe the sun. None to all of it is taken to go on, and "
            "the tests may have had more or less of it than the twin has."
        )
    rated_w = file.geometry["heater_max_w"].value
    yield f"All watts are in proportion to the present heater's, which is taken to give {rated_w:g} W."
    yield from _of_change(file, asked.change)
    needs = sorted(set(file.twin().needs) - {"utc"})
    if "solar" not in needs:
        yield "If the sun shone in while the twin was learnt, the box loses more than the twin has."
    if needs:
        yield f"The twin needs {', '.join(needs)}: taken are darkness and {HUMIDITY_PCT:g} % humidity."


def _of_rows(seen: Seen, asked_k: float) -> Iterator[str]:
    """asked_k : warmest air of the answer, over the room"""
    if math.isnan(seen.error_k):
        yield "The twin's file has no error over rows that no fit saw: none is in the intervals."
    if math.isnan(seen.above_k):
        yield "The twin's file does not say how warm the air was in its fit."
    elif asked_k > seen.above_k:
        yield (
            f"The fit saw air up to {seen.warmest_c:.1f} °C, {seen.above_k:.0f} K over the room. Beyond, "
            f"losses may grow by up to the power {BENT_MAX:g} more than in proportion, as by wet soil."
        )
    if not seen.seconds:
        yield "The twin's file does not say how many hours its fit saw: the intervals leave slow bodies out."
    elif seen.seconds < 3600.0 * SHORT_H:
        most = STORED_MAX * math.exp(-seen.seconds / SLOW_S)
        yield (
            f"The fit saw {seen.seconds / 3600.0:.1f} h at a time. Up to {most:.0%} of what it takes for "
            "losses may be heat into soil, water and walls, which ends; longer rows would tell."
        )


def _of_change(file: TwinFile, change: TwinChange) -> Iterator[str]:
    if change.heater_w is not None and heater_lag.__name__ in file.effects:
        yield "The other heater is taken to be as slow as the present one."
    if change.wall_factor is not None:
        heavy = change.wall_thickness != 1.0
        mass = f"may store {change.wall_thickness:.2g} times as much" if heavy else "keep their mass"
        yield (
            f"The walls conduct {change.wall_factor:.2f} times as much and {mass}. A fit counts leaks, "
            f"windows and the floor as walls: {WALL_SHARE_MIN:.0%} to all of that loss is taken to change."
        )
    if change.fan is not None:
        yield "The fan's share is of its flow, in the mean of a step."


def span(quantity: Quantity, unit: str) -> str:
    """Return an interval in words: `62 to 74 W`, or `about 62 W` where its ends look the same."""
    is_time = unit == "min"
    if math.isinf(quantity.low):
        return "never" if is_time else "without limit"
    low, high = (_digits(end, unit) for end in (quantity.low, quantity.high))
    if math.isinf(quantity.high):
        return f"{low} {unit} {'to never' if is_time else 'or more'}"
    return f"about {low} {unit}" if low == high else f"{low} to {high} {unit}"


def _digits(value: float, unit: str) -> str:
    """Return a number with as many digits as its unit deserves."""
    decimals = 2 if unit == "kWh" else 1 if unit == "°C" or abs(value) < 10.0 else 0
    return f"{value:.{decimals}f}"


def _as_sold(watts: float) -> float:
    """Return a power rounded up to two digits."""
    if not (watts > 0.0 and math.isfinite(watts)):
        return watts
    step = 10.0 ** (math.floor(math.log10(watts)) - 1)
    return math.ceil(watts / step - 1e-9) * step
