"""The box that the daemon is told of: its twin file, and the bounds that safety keeps it to.

A file with values still to be fitted tells the heater alone, and thermal supervision asks no question; a
fitted one gives the bounds, each with a margin that no healthy box of this kind leaves.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError, DataError
from edge.safety.box_bounds import PAPER_BOX, BoxBounds, unknown_box
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
EARLY_S, LATE_S = 300.0, 7200.0  # when a capacity is read off a warming box
SETTLED_S = 400_000.0  # when all of it is warm
ROOM_C = 20.0
# The paper's box by the same measure has 3000 to 10 000 J/K and 4 to 10 W/K: margins are those of its bounds.
CAPACITY, LOSS, FAN, WEAK, POWER = (0.6, 1.5), (0.6, 1.6), 0.5, 0.35, (0.75, 1.1)
BEFORE = ".before"  # ending of the description that a learned twin has replaced
OTHER_SHARE, OTHER_LONG_SHARE = 0.5, 0.3  # of the heater's power, that nobody ordered
LAG_S, LAG_TIMES = 300.0, 1.6


def bounds_of(path: str) -> BoxBounds:
    """Return the bounds of the box whose twin file this is; "" is the paper's. Errors: ConfigError"""
    if not path:
        return PAPER_BOX
    try:
        return box_bounds(read_twin_file(Path(path)))
    except DataError as error:
        raise ConfigError(f"box.twin: {error}") from error


def description_of(path: Path) -> TwinFile:
    """Return the description of the box whose twin file this is. Errors: DataError

    A learned twin takes the place of the description, which stays beside it: a box is learned anew from that.
    """
    file, before = read_twin_file(path), path.with_name(path.name + BEFORE)
    return read_twin_file(before) if not file.to_fit() and before.exists() else file


def box_bounds(file: TwinFile) -> BoxBounds:
    """Return the bounds of a fitted twin, by how it warms and how warm it gets."""
    heater_w = file.geometry["heater_max_w"].value
    if file.to_fit():
        return unknown_box(heater_w, file.fan_role)
    twin = replace(file, sample_s=60.0).twin()
    warming = _rise(twin, 0.0)
    still, fanned = heater_w / float(warming[-1]), heater_w / float(_rise(twin, 1.0)[-1])
    early, late = (_capacity_j_k(warming, heater_w, still, until_s) for until_s in (EARLY_S, LATE_S))
    fan_w_k = min(max(fanned - still, 0.0), _rated_fan_w_k(file))
    return BoxBounds(
        heater_w=heater_w,
        fan_role=file.fan_role,
        power_min_w=POWER[0] * heater_w,
        power_max_w=POWER[1] * heater_w,
        element_lag_s=max(LAG_S, LAG_TIMES * _element_lag_s(twin)),
        capacity_max_j_k=CAPACITY[1] * max(early, late),
        capacity_min_j_k=CAPACITY[0] * min(early, late),
        loss_max_w_k=LOSS[1] * still,
        loss_min_w_k=LOSS[0] * still,
        fan_min_w_k=FAN * fan_w_k,
        fan_weak_w_k=WEAK * fan_w_k,
        other_heat_w=OTHER_SHARE * heater_w,
        other_heat_long_w=OTHER_LONG_SHARE * heater_w,
        fan_cools=fan_w_k > still,
    )


def _rise(twin: BoxTwin, fan: float) -> Floats:
    """Return the air over the room after each minute of full heat from rest, then when all is warm [K]."""
    steps = round(LATE_S / twin.step_s)
    rest = at_rest(twin, ROOM_C, ROOM_C)
    conditions = {name: np.zeros(steps) for name in twin.needs}

    def run(count: int, one: BoxTwin) -> Floats:
        ones = np.ones((1, count))
        given = {name: np.zeros(count) for name in conditions}
        before = Commands(ones, fan * ones)
        with_heat = one.rollout(rest, ones, fan * ones, ROOM_C, conditions=given, before=before)
        without = one.rollout(rest, 0.0 * ones, fan * ones, ROOM_C, conditions=given)
        return np.asarray((with_heat - without)[0])

    slow = replace(twin, step_s=3600.0)
    return np.append(run(steps, twin), run(round(SETTLED_S / slow.step_s), slow)[-1])


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


def _capacity_j_k(warming: Floats, heater_w: float, loss_w_k: float, until_s: float) -> float:
    """Return the heat that has stayed in the box, by the warming of its air."""
    rows = round(until_s / 60.0)
    lost_j = loss_w_k * 60.0 * float(warming[:rows].sum())
    return (heater_w * until_s - lost_j) / float(warming[rows - 1])
