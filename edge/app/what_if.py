"""Answers of a fitted twin to *what if*: another heater, tighter walls, a weaker fan; with intervals.

Twins are drawn from the intervals of a twin file and their correlations, and each gives an answer. Two things
no fit can tell are drawn with them. The error of free runs over rows that no fit saw acts as an error of the
room. In warmer air than the fit has seen, losses grow by up to the power `BENT_MAX` more than in proportion.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import RequestError
from edge.twin.box_words import wall
from edge.twin.constant_inputs import ConstantInputs, SteadyTwin
from edge.twin.draws import drawn_twins, even_normals
from edge.twin.effects.loss import WALL_CONDUCTANCES
from edge.twin.model import BoxTwin
from edge.twin.new_file import resistance_m2_k_w
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
DRAWS = 200  # the ends of an interval of 90 % are then known to about a tenth of its width
LEVELS = (0.05, 0.5, 0.95)
BENT_MAX = 1.0 / 3.0  # turbulent natural convection, Nu ~ Ra^(1/3), Incropera & DeWitt, ch. 9
SEEN_MIN_K = 5.0  # over the room; a box in tests is warmed by more
# Leaks, seams and the floor are walls to a fit; so are films, which do not change with the thickness as ISO
# 6946 has them. Of the virtual board's chamber two thirds are conducted (bench/what_if.py).
WALL_SHARE_MIN = 0.5
WALL_KNOWN = 3.0  # times, from end to end of an interval of the walls' loss
WALL_PLACES: tuple[Place, ...] = tuple(("effects", effect, key) for effect, key in WALL_CONDUCTANCES)
_NORMAL = NormalDist()
HEATER: Place = ("geometry", "heater_max_w")
HUMIDITY_PCT = 60.0  # where the twin's plants and soil evaporate
DARK = {"light": 0.0, "solar": 0.0, "rel_humidity": HUMIDITY_PCT}


@dataclass(frozen=True, slots=True)
class TwinChange:
    """A change of the greenhouse; None: as it is.

    wall_factor : times the conduction through the walls; fan : share of the present flow
    """

    heater_w: float | None = None
    wall_factor: float | None = None
    fan: float | None = None


@dataclass(frozen=True, slots=True)
class WhatIf:
    """A question.

    room_c, start_c : room and air at the begin; target_c : to be reached; hold_c : to be held all day
    utc : now, for walls that age
    """

    change: TwinChange
    target_c: float
    room_c: float
    start_c: float
    hold_c: float
    utc: float


@dataclass(frozen=True, slots=True)
class Quantity:
    """The median of a quantity and its 90 % interval; infinite where never."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, draws: Floats) -> "Quantity":
        """Return the quantity of draws [D]."""
        # Between two draws nothing is interpolated: infinities would give NaN.
        low, value, high = np.quantile(draws, LEVELS, method="nearest")
        return cls(float(value), float(low), float(high))


@dataclass(frozen=True, slots=True)
class Outlook:
    """The behaviour of a greenhouse at the question's room.

    heater_w : rated; reach_c : air at full heat for good
    fanned_c, cooling_min : air by the fan without heat for good, and time by it from the target halfway to
        the room; None without a fan
    warm_up_min : from the start to the target at full heat; power_w : that holds the target
    energy_kwh_day : that holds `hold_c`, as far as the heater can
    sure : share of the draws that can hold the target
    """

    heater_w: float
    reach_c: Quantity
    fanned_c: Quantity | None
    cooling_min: Quantity | None
    warm_up_min: Quantity
    power_w: Quantity
    energy_kwh_day: Quantity
    sure: float


@dataclass(frozen=True, slots=True)
class Unseen:
    """The bounds of what a fit has seen, by its file; NaN where the file does not say.

    seen_c, seen_k : warmest air, and over the room; error_k : of free runs over rows that no fit saw
    """

    seen_c: float
    seen_k: float
    error_k: float

    @classmethod
    def of(cls, file: TwinFile) -> "Unseen":
        """Read them from the provenance."""
        air = provenance_numbers(file, "validity", "temp_air_c")
        room = provenance_numbers(file, "validity", "temp_ambient_c")
        error = provenance_numbers(file, "after", "test", "rmse_k")
        seen_k = max(air[-1] - sum(room) / len(room), SEEN_MIN_K) if air and room else math.nan
        return cls(air[-1] if air else math.nan, seen_k, error[0] if error else math.nan)

    def twin_c(self, box_c: float, room_c: float, bent: float) -> float:
        """Return the air of the twin that loses as much as the box at `box_c`."""
        return self._bend(box_c, room_c, 1.0 + bent)

    def box_c(self, twin_c: float, room_c: float, bent: float) -> float:
        """Return the air of the box that loses as much as the twin at `twin_c`."""
        return self._bend(twin_c, room_c, 1.0 / (1.0 + bent))

    def _bend(self, temp_c: float, room_c: float, power: float) -> float:
        excess_k = temp_c - room_c
        if not excess_k > self.seen_k:  # NaN lands here too
            return temp_c
        return float(room_c + self.seen_k * (excess_k / self.seen_k) ** power)


class _Draw(NamedTuple):
    """An answer of one twin: temperatures [°C], times [s], shares of the heater's power."""

    reach_c: float
    fanned_c: float
    cooling_s: float
    warming_s: float
    target_share: float
    hold_share: float


def outlooks(file: TwinFile, asked: WhatIf, duty_max: float) -> tuple[Outlook, Outlook | None]:
    """Return what the greenhouse does now, and with the change if there is one.

    duty_max : the heater's largest duty on this rig
    Errors : RequestError for a change of what the twin does not have, DataError by the twin
    """
    drawn = drawn_twins(file, DRAWS)
    _check_change(file, drawn, asked.change)
    now = _outlook(file, drawn, TwinChange(), asked, duty_max)
    is_same = asked.change == TwinChange()
    return now, None if is_same else _outlook(file, drawn, asked.change, asked, duty_max)


def wall_factor(present: str, new_mm: float) -> float:
    """Return the factor of conduction through walls of the same material and another thickness, ISO 6946.

    present : like `polycarbonate:8mm`
    Errors : RequestError
    """
    material, thickness_m = wall(present)
    return resistance_m2_k_w(material, thickness_m) / resistance_m2_k_w(material, 1e-3 * new_mm)


def provenance_numbers(file: TwinFile, *keys: str) -> list[float]:
    """Return a number, or a list of numbers, of the provenance; empty where there is none."""
    found: Any = file.provenance
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    items = found if isinstance(found, list) else [found]
    numbers = [float(item) for item in items if isinstance(item, int | float)]
    return numbers if len(numbers) == len(items) and all(map(math.isfinite, numbers)) else []


def _outlook(
    file: TwinFile, drawn: Sequence[TwinFile], change: TwinChange, asked: WhatIf, duty_max: float
) -> Outlook:
    heater_w = file.geometry["heater_max_w"].value if change.heater_w is None else change.heater_w
    fan = None if file.fan_role != "exhaust" else 1.0 if change.fan is None else change.fan
    unseen = Unseen.of(file)
    most_k = 0.0 if math.isnan(unseen.error_k) else unseen.error_k
    # The same draws for now and with the change, which so differ by the change alone.
    errors, *levels = even_normals(len(drawn), 3).T.tolist()
    bends, walls = ([_NORMAL.cdf(sds) for sds in column] for column in levels)
    found = []
    for own, error, bend, through in zip(drawn, errors, bends, walls, strict=True):
        twin = _with_change(own, change, WALL_SHARE_MIN + (1.0 - WALL_SHARE_MIN) * through).twin()
        felt_c = asked.room_c + most_k * error
        found.append(_draw(twin, fan, asked, duty_max, unseen, felt_c, BENT_MAX * bend))
    reach_c, fanned_c, cooling_s, warming_s, target_share, hold_share = np.array(found).T
    is_cooled = fan is not None and asked.target_c > asked.room_c
    return Outlook(
        heater_w,
        Quantity.of(reach_c),
        None if fan is None else Quantity.of(fanned_c),
        Quantity.of(cooling_s / 60.0) if is_cooled else None,
        Quantity.of(warming_s / 60.0),
        Quantity.of(heater_w * np.maximum(target_share, 0.0)),
        Quantity.of(24e-3 * heater_w * np.clip(hold_share, 0.0, duty_max)),
        float(np.mean(target_share <= duty_max)),
    )


def _draw(
    twin: BoxTwin,
    fan: float | None,
    asked: WhatIf,
    duty_max: float,
    unseen: Unseen,
    felt_c: float,
    bent: float,
) -> _Draw:
    """Ask one twin. felt_c : room with its error; bent : power by which losses grow in unseen air"""
    room_c, signals = asked.room_c, twin.signals
    columns = {name: {**DARK, "utc": asked.utc}[name] for name in twin.needs}
    still = SteadyTwin(twin, ConstantInputs(felt_c, 0.0, columns))
    target_c, hold_c = (unseen.twin_c(temp_c, room_c, bent) for temp_c in (asked.target_c, asked.hold_c))
    fanned_c = cooling_s = math.nan
    if fan is not None:
        blown = SteadyTwin(twin, ConstantInputs(felt_c, fan, columns))
        fanned_c, dead_s = blown.final_c(0.0), signals.fan_dead_s + signals.fan_lag_s
        cooling_s = blown.time_s(still.rest_at(target_c), 0.5 * (target_c + room_c), 0.0, dead_s)
    warming_s = 0.0
    if target_c > asked.start_c:
        warming_s = still.time_s(still.rest_at(asked.start_c), target_c, duty_max, signals.heater_dead_s)
    reach_c = unseen.box_c(still.final_c(duty_max), room_c, bent)
    shares = still.share_to_hold(target_c), still.share_to_hold(hold_c)
    return _Draw(reach_c, fanned_c, cooling_s, warming_s, *shares)


def _with_change(file: TwinFile, change: TwinChange, through_walls: float) -> TwinFile:
    """through_walls : share of what the twin counts as loss of the walls that they conduct"""
    values = file.values()
    changed = {} if change.heater_w is None else {HEATER: Value(change.heater_w)}
    if change.wall_factor is not None:
        walls = [place for place in WALL_PLACES if place in values]
        factor = 1.0 + through_walls * (change.wall_factor - 1.0)
        changed |= {place: Value(factor * values[place].value) for place in walls}
    return file.with_values(changed)


def _wall_w_k(file: TwinFile) -> float:
    """Return the conductance of the walls, 0 where the twin has none."""
    values = {place: value.value for place, value in file.values().items()}
    inner, outer, straight = (values.get(place, 0.0) for place in WALL_PLACES)
    return 1.0 / (1.0 / inner + 1.0 / outer) if inner > 0.0 and outer > 0.0 else straight


def _check_change(file: TwinFile, drawn: Sequence[TwinFile], change: TwinChange) -> None:
    """Refuse a change of what the twin does not have or know. Errors: RequestError"""
    if change.fan is not None and file.fan_role != "exhaust":
        raise RequestError(f"fan: the twin has no fan that changes the air (fan_role: {file.fan_role})")
    if change.wall_factor is None:
        return
    low, _, high = np.quantile([_wall_w_k(own) for own in drawn], LEVELS)
    if not high > 0.0:
        others = ", ".join(file.effects) or "no effect"
        raise RequestError(f"walls: the twin has none of its own, but {others}")
    if not high < WALL_KNOWN * low:
        raise RequestError(
            f"walls: the twin knows their loss only as {max(low, 0.0):.2g} to {high:.2g} W/K, which is too "
            "little to tell a change of them"
        )
