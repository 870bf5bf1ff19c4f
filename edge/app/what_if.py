"""Answers of a fitted twin to *what if*: another heater, tighter walls, a weaker fan; with intervals.

Twins are drawn from the intervals of a twin file and their correlations, and each gives an answer. A fit
leaves further things open, and each twin is drawn with its own `_Doubt` about them.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import RequestError
from edge.twin.box_words import wall
from edge.twin.constant_inputs import ConstantInputs, SteadyTwin
from edge.twin.draws import drawn_twins, even_normals
from edge.twin.effects.library import EFFECTS, nameless
from edge.twin.effects.named import WALL_CAPACITIES, WALL_CONDUCTANCES
from edge.twin.model import BoxTwin
from edge.twin.new_file import resistance_m2_k_w
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
DRAWS = 200  # the ends of an interval of 90 % are then known to about a tenth of its width
LEVELS = (0.05, 0.5, 0.95)
# Films have 0.25 to 0.33, air that rises out of leaks 0.5 (ASHRAE Fundamentals 2017, ch. 4 and 16). Wet soil,
# whose vapour doubles with every 11 K, and a heater whose power falls when hot come near 1.
BENT_MAX = 1.0
# Of what a short fit takes for losses: into water, soil and thick walls, up to twice what gets out.
STORED_MAX, SLOW_S = 2.0 / 3.0, 12.0 * 3600.0  # and the length of rows that shows them
MIDDLE = 0.6  # of the warmest over the room: root mean square of rows that are spread evenly
LOSS_MIN = 0.2  # of the fit's, where heat of no known cause would leave nothing
STEPS = 9  # of air temperatures at which that heat is looked at
SEEN_MIN_K = 5.0  # over the room; a box in tests is warmed by more
# Leaks, seams and the floor are walls to a fit; so are films, which do not change with the thickness as ISO
# 6946 has them. Of the virtual board's chamber two thirds are conducted (bench/what_if.py at 02ed168c).
WALL_SHARE_MIN = 1.0 / 3.0
WALL_KNOWN = 3.0  # times, from end to end of an interval of the walls' loss
WALL_PLACES: tuple[Place, ...] = tuple(("effects", effect, key) for effect, key in WALL_CONDUCTANCES)
_NORMAL = NormalDist()
HUMIDITY_PCT = 60.0  # where the twin's plants and soil evaporate
DARK = {"light": 0.0, "solar": 0.0, "rel_humidity": HUMIDITY_PCT}


@dataclass(frozen=True, slots=True)
class TwinChange:
    """A change of the greenhouse; None: as it is.

    wall_factor : times the conduction through the walls; wall_thickness : times their thickness and mass
    fan : share of the present flow
    """

    heater_w: float | None = None
    wall_factor: float | None = None
    wall_thickness: float = 1.0
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


class Seen(NamedTuple):
    """The rows of a fit, by its file; NaN where the file does not say.

    warmest_c, above_k : warmest air, and over the room; error_k : of free runs over rows that no fit saw
    seconds : at a time, 0 where the file does not say
    """

    warmest_c: float
    above_k: float
    error_k: float
    seconds: float

    @classmethod
    def of(cls, file: TwinFile) -> "Seen":
        """Read them from the provenance."""
        air, room, hours = (
            _numbers(file, "validity", key) for key in ("temp_air_c", "temp_ambient_c", "hours")
        )
        error = _numbers(file, "after", "test", "rmse_k")
        above_k = max(air[-1] - sum(room) / len(room), SEEN_MIN_K) if air and room else math.nan
        return cls(
            air[-1] if air else math.nan,
            above_k,
            error[0] if error else math.nan,
            3600.0 * hours[0] if hours else 0.0,
        )


def _numbers(file: TwinFile, *keys: str) -> list[float]:
    """Return a number, or a list of numbers, of the provenance; empty where there is none."""
    found: Any = file.provenance
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    items = found if isinstance(found, list) else [found]
    numbers = [float(item) for item in items if isinstance(item, int | float)]
    return numbers if len(numbers) == len(items) and all(map(math.isfinite, numbers)) else []


class _Doubt(NamedTuple):
    """The things that a fit leaves open, as one draw has them. Shares are from 0 to 1.

    room_k : error of the room, as large as that of free runs over rows that no fit saw
    loss : factor of all heat that leaves or is stored, which makes that error in the middle of the rows
    bent : power by which losses grow in warmer air than the rows had, beyond proportion
    through_walls : share of what the twin counts as loss of the walls that they conduct
    stored_in_walls : share of what the twin counts as stored near the air that is stored in the walls
    stored : share of the losses which is heat into bodies that are too slow for the rows
    lost : share of the heat into slow bodies that leaves them for the room
    late_steps : by which the time to a target is off, as the rig acts once a step
    then : heat of no known cause in the middle of the rows, between its least and its most in all of them
    now : share of it that goes on
    """

    room_k: float
    loss: float
    bent: float
    through_walls: float
    stored_in_walls: float
    stored: float
    lost: float
    late_steps: float
    then: float
    now: float


class _Draw(NamedTuple):
    """An answer of one twin: temperatures [°C], times [s], duties."""

    reach_c: float
    fanned_c: float
    cooling_s: float
    warming_s: float
    target_duty: float
    hold_duty: float


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


def other_walls(present: str, new_mm: float) -> tuple[float, float]:
    """Return `wall_factor` and `wall_thickness` for the same material and another thickness, ISO 6946.

    present : like `polycarbonate:8mm`
    Errors : RequestError
    """
    material, thickness_m = wall(present)
    new_m = 1e-3 * new_mm
    factor = resistance_m2_k_w(material, thickness_m) / resistance_m2_k_w(material, new_m)
    return factor, new_m / thickness_m


def _outlook(
    file: TwinFile, drawn: Sequence[TwinFile], change: TwinChange, asked: WhatIf, duty_max: float
) -> Outlook:
    heater_w = file.geometry["heater_max_w"].value if change.heater_w is None else change.heater_w
    fan = None if file.fan_role != "exhaust" else 1.0 if change.fan is None else change.fan
    seen = Seen.of(file)
    # The same draws for now and with the change, which so differ by the change alone.
    found = [
        _draw(own, change, fan, asked, duty_max, seen, doubt)
        for own, doubt in zip(drawn, _doubts(seen, len(drawn)), strict=True)
    ]
    reach_c, fanned_c, cooling_s, warming_s, target_duty, hold_duty = np.array(found).T
    is_cooled = fan is not None and asked.target_c > asked.room_c
    return Outlook(
        heater_w,
        Quantity.of(reach_c),
        None if fan is None else Quantity.of(fanned_c),
        Quantity.of(cooling_s / 60.0) if is_cooled else None,
        Quantity.of(warming_s / 60.0),
        Quantity.of(heater_w * np.maximum(target_duty, 0.0)),
        Quantity.of(24e-3 * heater_w * np.clip(hold_duty, 0.0, duty_max)),
        float(np.mean(target_duty <= duty_max)),
    )


def _doubts(seen: Seen, count: int) -> Iterator[_Doubt]:
    error_k = 0.0 if math.isnan(seen.error_k) else seen.error_k
    relative = 0.0 if math.isnan(seen.above_k) else error_k / (MIDDLE * seen.above_k)
    longest = STORED_MAX * math.exp(-seen.seconds / SLOW_S)
    for room, loss, *others in even_normals(count, len(_Doubt._fields)).tolist():
        bent, walls, in_walls, stored, lost, late, *shares = (_NORMAL.cdf(sds) for sds in others)
        yield _Doubt(
            error_k * room,
            math.exp(relative * loss),
            BENT_MAX * bent**2,  # squared, as most boxes are near none
            WALL_SHARE_MIN + (1.0 - WALL_SHARE_MIN) * walls,
            in_walls,
            longest * stored**2,
            lost,
            late - 0.5,
            *shares,
        )


def _draw(
    file: TwinFile,
    change: TwinChange,
    fan: float | None,
    asked: WhatIf,
    duty_max: float,
    seen: Seen,
    doubt: _Doubt,
) -> _Draw:
    room_c, target_c = asked.room_c, asked.target_c
    rated_w = file.geometry["heater_max_w"].value
    loss = doubt.loss * _hidden_loss(file, asked, seen, doubt)
    twin = _with_change(file, change, doubt).twin()
    signals = twin.signals
    inputs = ConstantInputs(
        room_c + doubt.room_k,
        columns=_columns(twin, asked),
        power=(change.heater_w or rated_w) / (rated_w * loss),
        seen_s=seen.seconds,
        stored=doubt.stored,
        lost=doubt.lost,
    )
    inputs = replace(inputs, more_w=_bent_w(twin, inputs, room_c, seen, doubt))
    still = SteadyTwin(twin, inputs)
    fanned_c = cooling_s = math.nan
    if fan is not None:
        blown = SteadyTwin(twin, replace(inputs, fan=fan))
        fanned_c = blown.final_c(0.0)
        dead_s = signals.fan_dead_s + signals.fan_lag_s + doubt.late_steps * twin.step_s
        halfway_c = 0.5 * (target_c + room_c)
        cooling_s = max(blown.time_s(still.rest_at(target_c), halfway_c, 0.0, dead_s), 0.0)
    warming_s = 0.0
    if target_c > asked.start_c:
        dead_s = signals.heater_dead_s + doubt.late_steps * twin.step_s
        warming_s = max(still.time_s(still.rest_at(asked.start_c), target_c, duty_max, dead_s), 0.0)
    duties = still.duty_to_hold(target_c), still.duty_to_hold(asked.hold_c)
    return _Draw(still.final_c(duty_max), fanned_c, cooling_s, warming_s, *duties)


def _hidden_loss(file: TwinFile, asked: WhatIf, seen: Seen, doubt: _Doubt) -> float:
    """Return the factor of all losses where the rows had other heat of no known cause than the twin has.

    The sun is not there for cool rows alone. Heat that a fit missed in warm ones it took off the losses.
    """
    twin = file.twin()
    unknown = {name: twin.effects[name] for name in nameless(twin.effects)}
    if not unknown or math.isnan(seen.above_k):
        return 1.0
    coldest_c, middle_c = (seen.warmest_c - share * seen.above_k for share in (1.0, 1.0 - MIDDLE))
    temps = np.array([middle_c, *np.linspace(coldest_c, seen.warmest_c, STEPS)])
    off = {"heater_duty": np.zeros(())}
    found = BoxTwin(twin.geometry, unknown).signals.heat_w(temps, np.array(coldest_c), off, by_temp=True)
    middle_w, *all_w = np.broadcast_to(found, temps.shape).tolist()
    least_w, most_w = min(all_w), max(all_w)
    steady = SteadyTwin(twin, ConstantInputs(coldest_c, 0.0, _columns(twin, asked)))
    lost_w = twin.geometry.heater_max_w * steady.share_to_hold(middle_c) + middle_w
    more_w = least_w + doubt.then * (most_w - least_w) - middle_w
    return max(1.0 + more_w / lost_w, LOSS_MIN) if lost_w > 0.0 else 1.0


def _bent_w(
    twin: BoxTwin, inputs: ConstantInputs, room_c: float, seen: Seen, doubt: _Doubt
) -> Callable[[float], float] | None:
    """Return the heat [W] by which losses in warmer air than the rows had are out of proportion."""
    if math.isnan(seen.above_k):
        return None
    steady = SteadyTwin(twin, inputs)
    low, high = (steady.share_to_hold(temp_c) for temp_c in (room_c, room_c + seen.above_k))
    lost_w = max(inputs.power * twin.geometry.heater_max_w * (high - low), 0.0)

    def more_w(temp_c: float) -> float:
        times = max((temp_c - room_c) / seen.above_k, 1.0)
        return lost_w * (times - math.pow(times, 1.0 + doubt.bent))

    return more_w


def _columns(twin: BoxTwin, asked: WhatIf) -> dict[str, float]:
    return {name: {**DARK, "utc": asked.utc}[name] for name in twin.needs}


def _with_change(file: TwinFile, change: TwinChange, doubt: _Doubt) -> TwinFile:
    """Return the twin with other walls, and the heat of no known cause that goes on."""
    values = file.values()
    changed: dict[Place, Value] = {}
    for name in nameless(file.effects):
        amount: Place = ("effects", name, EFFECTS[name].parameters[0].name)
        changed[amount] = Value(doubt.now * values[amount].value)
    if change.wall_factor is not None:
        factor = 1.0 + doubt.through_walls * (change.wall_factor - 1.0)
        changed |= {place: Value(factor * values[place].value) for place in WALL_PLACES if place in values}
        times = 1.0 + doubt.stored_in_walls * (change.wall_thickness - 1.0)
        for effect, key, none in WALL_CAPACITIES:
            place: Place = ("effects", effect, key)
            if place in values:
                changed[place] = Value(none + times * (values[place].value - none))
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
