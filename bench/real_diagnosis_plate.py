"""The heater's state that the twin infers, against the plate's temperature, which it was never told."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.gap import RunForecast
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.warm_start import PastColumns, state_now

Floats = NDArray[np.float64]


class HeaterStates(NamedTuple):
    """Over the rows of a run behind the start of its free run: simulated air [°C] and heat of the element
    [W], and the plate as it was measured [°C]."""

    air_c: Floats
    heat_w: Floats
    plate_c: Floats


class Plate(NamedTuple):
    """How well simulated states tell the plate's temperature.

    warmer_k_w : what it is above the air, per watt; offset_k : of its sensor against the air's
    correlation, explained : of measured with told, and the share of variance, over held-out rows
    """

    warmer_k_w: float
    offset_k: float
    correlation: float
    explained: float


def heater_states(
    twin: BoxTwin, free: RunForecast, duty: Floats, room_c: Floats, plate_c: Floats
) -> HeaterStates:
    """Return the states of a free run, fan off. duty, room_c, plate_c : [rows] of its run"""
    start, heater = free.start, twin.states.index(HEATER)
    plate_c, duty = plate_c[: len(free.measured)], duty[: len(free.measured)]
    off = np.zeros(start + 1)
    known = PastColumns(free.measured[: start + 1], room_c[: start + 1], duty[: start + 1], off)
    state = state_now(twin, known)
    states = []
    for k in range(start, len(duty) - 1):
        state = twin.advance(state, room_c[k], duty[k], 0.0)
        states.append(state)
    found = np.array(states)
    return HeaterStates(found[:, 0], found[:, heater], plate_c[start + 1 :])


def plate_of(train: Sequence[HeaterStates], test: Sequence[HeaterStates]) -> Plate:
    """Fit on training runs how much warmer the plate is than the air, in
    proportion to the heat that leaves it.
    """
    fitted, rest = (
        HeaterStates(*(np.concatenate(part) for part in zip(*runs, strict=True))) for runs in (train, test)
    )
    per_w, offset = np.polyfit(fitted.heat_w, fitted.plate_c - fitted.air_c, 1)
    told = rest.air_c + offset + per_w * rest.heat_w
    missed = float(np.mean((rest.plate_c - told) ** 2) / np.var(rest.plate_c))
    correlation = float(np.corrcoef(told, rest.plate_c)[0, 1])
    return Plate(float(per_w), float(offset), correlation, 1.0 - missed)
