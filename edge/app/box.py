"""The box that the daemon is told of: its twin file, and the bounds that safety keeps it to.

A file with values still to be fitted tells the heater alone, and thermal supervision asks no question. A
fitted one gives bounds, each with a margin. They are read off the twin's first two hours, the usual length of
step tests: of what a box stores beyond its tests no twin knows. Then the healthy twin goes through the events
that are most like a fault, and bounds that would blame it are widened.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import BoxSettings
from edge.core.errors import ConfigError, DataError
from edge.safety.box_bounds import PAPER_BOX, BoxBounds, paper_box, unknown_box
from edge.safety.thermal_supervision import (
    COOLED_SHARE,
    COOLING_S,
    EXPECTED_RISE_K,
    LONG_S,
    SEEN_RISE_K,
    SETTLE_S,
    SHORT_S,
    Balance,
    unordered_w,
)
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
STEP_S, HOUR_S = 60.0, 3600.0
TESTS_S = 7200.0  # of commissioning; losses are those after so long
SETTLED_S = 200_000.0  # when all of it is warm, but for what LOSS_SETTLED allows
QUICK_S = 300.0  # in which the quickest capacity is seen
ROOM_C = 20.0
HOTTEST_K = 20.0  # over the room: little is kept warmer, and the limit of the air is 40 °C
CAPACITY, LOSS, FAN, WEAK, POWER = (0.6, 1.5), (0.6, 1.6), 0.35, 0.35, (0.75, 1.1)
# Fresh from its tests: the settled loss is 0.45 of that after two hours in a heavy box, 1.0 in a light one.
LOSS_FRESH = 0.4
COMMISSION = "greenhouse commission"  # in a twin's provenance: it knows no more than its tests
LOSS_SETTLED = 0.8  # of what the twin itself says of later days
BEFORE = ".before"  # ending of the description that a learned twin has replaced
OTHER_SHARE, OTHER_LONG_SHARE = 0.5, 0.3  # of the heater's power, that nobody ordered
LATE_SHARE = 0.25  # of the heater's power, that still comes SETTLE_S after it was told off
LAG_S, LAG_TIMES = 300.0, 1.6
MOMENT_S = 5.0  # over which the air's fastest change is taken
LONGER = 1.5  # so many times the rise of TESTS_S comes in a day
SURE = 1.3  # a healthy twin must stay so many times away from a finding


def bounds_of(box: BoxSettings) -> BoxBounds:
    """Return the bounds of a box: its twin file's, else the paper's with its heater. Errors: ConfigError"""
    if not box.twin:
        return paper_box(box.heater_w)
    try:
        bounds = box_bounds(read_twin_file(Path(box.twin)))
    except DataError as error:
        raise ConfigError(f"box.twin: {error}") from error
    if box.heater_w not in (0.0, bounds.heater_w):
        raise ConfigError(f"box.heater_w: {box.heater_w:g} W, but {box.twin} has {bounds.heater_w:g} W")
    return bounds


def description_of(path: Path) -> TwinFile:
    """Return the description of the box whose twin file this is. Errors: DataError

    A learned twin takes the place of the description, which stays beside it: a box is learned anew from that.
    """
    file, before = read_twin_file(path), path.with_name(path.name + BEFORE)
    return read_twin_file(before) if not file.to_fit() and before.exists() else file


def box_bounds(file: TwinFile) -> BoxBounds:
    """Return the bounds of a fitted twin, by how it warms and cools."""
    heater_w = file.geometry["heater_max_w"].value
    if file.to_fit():
        return unknown_box(heater_w, file.fan_role)
    twin = file.twin().in_steps(STEP_S)
    warming, blown = (_rise(twin, fan, TESTS_S) for fan in (0.0, 1.0))
    settled_k = float(_rise(twin.in_steps(HOUR_S), 0.0, SETTLED_S)[-1])
    loss_w_k = heater_w / warming[-1]
    least = LOSS_FRESH if file.provenance.get("command") == COMMISSION else LOSS[0]
    is_exhaust = file.fan_role == "exhaust"  # one that stirs may warm the air as well as cool it
    fan_w_k = min(max(heater_w / blown[-1] - loss_w_k, 0.0), _rated_fan_w_k(file)) if is_exhaust else 0.0
    bounds = BoxBounds(
        heater_w=heater_w,
        fan_role=file.fan_role,
        power_min_w=POWER[0] * heater_w,
        power_max_w=POWER[1] * heater_w,
        element_lag_s=max(LAG_S, LAG_TIMES * _element_lag_s(twin)),
        capacity_max_j_k=CAPACITY[1] * _capacity_j_k(warming, heater_w, loss_w_k),
        capacity_min_j_k=CAPACITY[0] * _quick_capacity_j_k(warming, heater_w, loss_w_k),
        loss_max_w_k=LOSS[1] * loss_w_k,
        loss_min_w_k=min(least * loss_w_k, LOSS_SETTLED * heater_w / settled_k),
        fan_min_w_k=FAN * fan_w_k,
        fan_weak_w_k=WEAK * fan_w_k,
        other_heat_w=OTHER_SHARE * heater_w,
        other_heat_long_w=OTHER_LONG_SHARE * heater_w,
        air_rate_max_k_s=max(PAPER_BOX.air_rate_max_k_s, SURE * _fastest_k_s(twin)),
    )
    return _without_false_names(bounds, twin, warming, settled_k)


def _without_false_names(bounds: BoxBounds, twin: BoxTwin, warming: Floats, settled_k: float) -> BoxBounds:
    """Return bounds by which the healthy twin is far from every finding of thermal supervision."""
    late_k = _late_rise_k(twin)
    if late_k > 0.0:
        most_j_k = LATE_SHARE * bounds.heater_w * SHORT_S / late_k
        bounds = replace(bounds, capacity_min_j_k=min(bounds.capacity_min_j_k, most_j_k))
    bounds = replace(bounds, capacity_max_j_k=max(bounds.capacity_max_j_k, _slow_j_k(warming, bounds)))
    hottest_k = min(HOTTEST_K, max(LONGER * float(warming[-1]), settled_k))
    still, blown = (_cooling(twin, hottest_k, fan) for fan in (0.0, 1.0))
    cools = bounds.fan_role == "exhaust" and _is_cooled(blown)
    courses = [(still, False), (blown, True)] if bounds.fan_min_w_k > 0.0 else [(still, False)]
    short_w, long_w = (
        max(_unordered_w(air, fanned, from_s, seconds, bounds) for air, fanned in courses)
        for from_s, seconds in ((SETTLE_S, SHORT_S), (0.0, LONG_S))
    )
    return replace(
        bounds,
        fan_cools=cools,
        other_heat_w=max(bounds.other_heat_w, SURE * short_w),
        other_heat_long_w=max(bounds.other_heat_long_w, SURE * long_w),
    )


def _rise(twin: BoxTwin, fan: float, until_s: float) -> Floats:
    """Return the air over the room after each step of full heat from rest, from its beginning on [K]."""
    duty: Floats = np.outer([1.0, 0.0], np.ones(round(until_s / twin.step_s)))
    heated, idle = _run(twin, at_rest(twin, ROOM_C, ROOM_C), duty, np.full_like(duty, fan))
    return np.append(0.0, heated - idle)


def _cooling(twin: BoxTwin, hottest_k: float, fan: float, until_s: float = SETTLE_S + 2.0 * LONG_S) -> Floats:
    """Return the air over the room from a long hold on, after each step without heat [K]."""
    off: Floats = np.zeros((2, round(until_s / twin.step_s)))
    starts = np.stack([at_rest(twin, ROOM_C + warmer_k, ROOM_C) for warmer_k in (hottest_k, 0.0)])
    air, idle = _run(twin, starts, off, off + fan)
    return np.append(hottest_k, air - idle)


def _late_rise_k(twin: BoxTwin) -> float:
    """Return the largest rise over SHORT_S that begins SETTLE_S or more after full heat has ended."""
    rows, settled, window = (round(seconds / STEP_S) for seconds in (TESTS_S, SETTLE_S, SHORT_S))
    ends = (0, rows // 8, rows // 4, rows // 2)
    duty: Floats = np.array([np.arange(rows) < end for end in ends], dtype=np.float64)
    idle, *heated = _run(twin, at_rest(twin, ROOM_C, ROOM_C), duty, np.zeros_like(duty))
    largest_k = 0.0
    for end, air in zip(ends[1:], heated, strict=True):
        after = (air - idle)[end + settled - 1 :]
        largest_k = max(largest_k, float((after[window:] - after[:-window]).max()))
    return largest_k


def _run(twin: BoxTwin, start: Floats, duty: Floats, fan: Floats) -> Floats:
    """Return the air [M, N] under inputs [M, N]. start : states, or [M, states]"""
    given = {name: np.zeros(duty.shape[1]) for name in twin.needs}
    return np.asarray(twin.rollout(start, *Commands(duty, fan), ROOM_C, conditions=given))


def _fastest_k_s(twin: BoxTwin) -> float:
    """Return the fastest change of the air: full heat from rest, or the fan in the warmest box [K/s]."""
    quick = twin.in_steps(MOMENT_S)
    warming = _rise(quick, 0.0, QUICK_S)
    blown = _cooling(quick, HOTTEST_K, 1.0, QUICK_S)
    return max(float(np.abs(np.diff(air)).max()) for air in (warming, blown)) / MOMENT_S


def _element_lag_s(twin: BoxTwin) -> float:
    """Return the time constant of the heater's element, 0 for one whose heat is there at once [s]."""
    if HEATER not in twin.states:
        return 0.0
    place = twin.states.index(HEATER)
    return -1.0 / float(twin.system.rates[place, place])


def _rated_fan_w_k(file: TwinFile) -> float:
    geometry = {name: value.value for name, value in file.geometry.items()}
    heat_j_m3_k = geometry["air_density_kg_m3"] * geometry["air_heat_capacity_j_kg_k"]
    return geometry["fan_max_m3_s"] * heat_j_m3_k


def _capacity_j_k(warming: Floats, heater_w: float, loss_w_k: float) -> float:
    """Return the heat that has stayed in the box, by the warming of its air."""
    return (heater_w * TESTS_S - loss_w_k * STEP_S * float(warming[1:].sum())) / float(warming[-1])


def _quick_capacity_j_k(warming: Floats, heater_w: float, loss_w_k: float) -> float:
    """Return the same over the QUICK_S of the fastest rise, after the lags of element and sensor."""
    rows = round(QUICK_S / STEP_S)
    rises = warming[rows:] - warming[:-rows]
    begin = int(np.argmax(rises))
    lost_j = loss_w_k * STEP_S * float(warming[begin + 1 : begin + rows + 1].sum())
    return (heater_w * QUICK_S - lost_j) / float(rises[begin])


def _slow_j_k(warming: Floats, bounds: BoxBounds) -> float:
    """Return the capacity by which the rise that supervision expects is not sooner than the twin's.

    Supervision expects EXPECTED_RISE_K of the weakest heater; by then SEEN_RISE_K must have been seen.
    """
    seen = int(np.argmax(warming >= SURE * SEEN_RISE_K)) or len(warming) - 1
    heat_w = np.maximum(bounds.power_min_w - bounds.loss_max_w_k * warming[1 : seen + 1], 0.0)
    return STEP_S * float(heat_w.sum()) / EXPECTED_RISE_K


def _is_cooled(blown: Floats) -> bool:
    """Say whether the fan takes clearly more than the share of the excess that supervision waits for."""
    return float(blown[round(COOLING_S / STEP_S)]) <= (1.0 - SURE * COOLED_SHARE) * float(blown[0])


def _unordered_w(air: Floats, fanned: bool, from_s: float, seconds: float, bounds: BoxBounds) -> float:
    """Return the largest heat that a balance over a cooling healthy box finds [W]. air : over the room [K]"""
    first, rows = round(from_s / STEP_S), round(seconds / STEP_S)
    found = []
    for begin in range(first, len(air) - rows):
        excess = STEP_S * float(air[begin + 1 : begin + rows + 1].sum())
        balance = Balance(float(air[begin]), 0.0, seconds, excess, excess if fanned else 0.0)
        found.append(unordered_w(balance, float(air[begin + rows]), bounds))
    return max(found)
