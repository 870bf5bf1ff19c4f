"""Twins of different structure told by the same effects, so that their values can be compared.

A box whose slow part is named `wall_mass` and one in which it is named `soil_mass` answer alike. So each twin
is run through one course of heat and fan, and a twin of the shared structure is fitted to its answer. What
the twin leaves open, with its correlations, is told by the answers of twins drawn from its intervals.

Without a fan a slow box behind a fast sensor answers as a fast box behind a slow sensor does. A fit may find
either, and a mean over both is neither. Of values that answer as well, those of the slower box are taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.fitting import fit
from edge.diagnosis.free_fit import FINELY, exchanges, fit_values, rms_k
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.unknowns import place_unknowns, with_usual
from edge.twin.draws import drawn_twins
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
ROOM_C = 20.0
NOISE_K = 0.02  # of an answer that nobody would tell apart
DRAWS, STEPS = 12, 4  # twins drawn from a twin's intervals, iterations from its own values to theirs
AS_GOOD = 1.2  # times the least miss, or what nobody would tell apart
CAPACITY: Place = ("effects", "extra_capacity", "kC")
LEAST_SHARE = 0.01  # of what is usual: as near to nothing as a value that may be 0 counts
# Legs of the course: share of full heat, and length in steps of the twin, which are chosen to suit a box.
LEGS = (
    (1.0, 20), (0.0, 20), (0.5, 40), (0.0, 40), (0.75, 80), (0.25, 80), (1.0, 240), (0.0, 240),
    (0.5, 160), (0.1, 160), (0.8, 180), (0.0, 180),
)  # fmt: skip
FAN_EVERY, FAN_ROWS = 7, 3  # of so many rows the fan blows in so many, in every second leg
# What is where a box stands, or in a sensor's error, and not in how it is built.
OF_PLACE = (
    "constant_heat", "ambient_offset", "sensor_bias", "solar_gain", "evapotranspiration", "respiration_heat",
    "led_gain", "door_opening", "ua_drift", "unnamed_heat",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class SharedTwin:
    """A twin in the shared structure.

    miss_k : by which its answer differs from the original's, RMS
    sds : of the logarithm of each value, by what the original leaves open and by what the structure misses
    """

    file: TwinFile
    miss_k: float
    sds: dict[Place, float]


def in_structure(twin: TwinFile, start: TwinFile, names: Sequence[str]) -> SharedTwin:
    """Return the twin with the effects of `start` and these alone.

    start : a description of the box, its values to be fitted; names : effects beside those
    """
    course = answer(twin)
    file = replace(start, sample_s=twin.sample_s)
    for name in names:
        if name not in file.effects:
            file = with_usual(file, name)
    every = list(fit_values([file, _from_own(file, twin)], (), course, NOISE_K, SideBySide()))
    every += [found for one in every for found in _exchange_times(one, course)]
    misses_k = [miss_k if np.isfinite(miss_k := rms_k(found, course)) else np.inf for found in every]
    good_k = max(AS_GOOD * min(misses_k), NOISE_K)
    good = [(found, miss_k) for found, miss_k in zip(every, misses_k, strict=True) if miss_k <= good_k]
    fitted, miss_k = max(good, key=lambda own: _capacity(own[0].file))
    values = {place: Value(value.value) for place, value in fitted.file.values().items()}
    return SharedTwin(fitted.file.with_values(values), miss_k, _sds(twin, fitted))


def _capacity(file: TwinFile) -> float:
    own = file.values().get(CAPACITY)
    return own.value if own else 0.0


def _from_own(file: TwinFile, twin: TwinFile) -> TwinFile:
    """Return the file with the twin's own values to begin with, where it has them."""
    own = twin.values()
    return file.with_values(
        {
            place: Value(possible(file, place, own[place].value), fit=True)
            for place, value in file.values().items()
            if value.fit and place in own
        }
    )


def possible(file: TwinFile, place: Place, value: float) -> float:
    """Return the nearest value that a fit may begin from: a rig may tell anything."""
    usual = file.usual(place)
    return float(np.clip(value, max(usual.low, 1e-9), usual.high))


def _exchange_times(found: FittedTwin, course: RunBatch) -> list[FittedTwin]:
    """Return the fit from where the time of the box and that of a lag behind it have changed places."""
    begins = [place_unknowns(found.file, found.free, x) for x in exchanges(found)]
    return fit([replace(found.trial, file=file, free=found.free) for file in begins], course, FINELY)


def _sds(twin: TwinFile, fitted: FittedTwin) -> dict[Place, float]:
    begun = replace(fitted.trial, file=fitted.file, free=fitted.free)
    found = [fit([begun], answer(drawn), STEPS)[0].coordinates for drawn in drawn_twins(twin, DRAWS)]
    missed = np.sqrt(np.maximum(np.diag(fitted.covariance)[: len(fitted.free)], 0.0))
    sds = np.hypot(np.std(found, axis=0, ddof=1), missed)
    usual = {item.place: twin.usual(item.place).start for item in fitted.free}
    return {
        item.place: float(
            sd if item.log else sd * item.scale / max(item.value(x), LEAST_SHARE * usual[item.place])
        )
        for item, x, sd in zip(fitted.free, fitted.coordinates, sds, strict=True)
    }


def answer(twin: TwinFile, without: Sequence[str] = OF_PLACE) -> RunBatch:
    """Return the course and the twin's answer to it, at a room of ROOM_C, without these effects."""
    kept = {name: own for name, own in twin.effects.items() if name not in without}
    box = replace(twin, effects=kept).twin()
    duty = np.repeat([share for share, _ in LEGS], [rows for _, rows in LEGS])[None]
    second = np.repeat([i % 2 for i in range(len(LEGS))], [rows for _, rows in LEGS])
    blows = (np.arange(duty.shape[1]) % FAN_EVERY < FAN_ROWS) & (second == 1)
    fan = np.where(blows & (twin.fan_role != "none"), 1.0, 0.0)[None]
    room = np.full(duty.shape, ROOM_C)
    conditions = {name: np.zeros(duty.shape) for name in box.needs}
    start = at_rest(box, np.array([ROOM_C]), np.array([ROOM_C]))
    temps = box.rollout(start, duty, fan, room, conditions=conditions)
    return RunBatch(np.concatenate([np.full((1, 1), ROOM_C), temps], axis=1), duty, fan, room, conditions)
