"""The box of the data that a model was fitted on: inside it a forecast interpolates, outside nobody knows."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from edge.core.names import ACTUATORS, SIGNALS
from edge.core.predictor import Columns, Floats

Box = Mapping[str, tuple[float, float]]  # a column's key at a border -> its lowest and highest value
TOLERANCE = 1e-6  # the third step of a heater that moves by 0.05 is not 0.15

_TEMP, _AMBIENT = SIGNALS["temp_air"].key, SIGNALS["temp_ambient"].key
_CONTROLS = (ACTUATORS["heater_duty"].key, ACTUATORS["fan_on"].key)  # in the order of `controls`


def box_of(runs: Iterable[Columns], keys: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return the validity range of some runs.

    runs : columns by their keys at a border, NaN where missing; keys : those to bound
    Raises : KeyError for a column that a run has not, ValueError for one without any value
    """
    found = list(runs)
    box = {}
    for key in keys:
        values = np.concatenate([run[key] for run in found])
        values = values[np.isfinite(values)]
        box[key] = (float(values.min()), float(values.max()))
    return box


def outside_steps(
    box: Box, history: Columns, controls: Floats, ahead: Columns, temps: Floats
) -> NDArray[np.bool_]:
    """Which predictions of a rollout rest on anything outside the box, at their step or before; NaN does too.

    box : columns that are not in it are not looked at
    history, controls, ahead : what the rollout was given, `edge.core.predictor.Predictor.rollout`
    temps : what it returned, [B, N] [°C]
    Returns : [B, N]
    """
    left = _outside(box, _TEMP, temps)
    for column, key in enumerate(_CONTROLS):
        left |= _outside(box, key, controls[:, :, column])
    if _AMBIENT in box:
        left |= _outside(box, _AMBIENT, ahead["temp_ambient"][: temps.shape[1]])
    left |= _outside(box, _TEMP, history["temp_air"][-1:])
    return np.logical_or.accumulate(left, axis=1)


def _outside(box: Box, key: str, values: Floats) -> NDArray[np.bool_]:
    low, high = box.get(key, (-np.inf, np.inf))
    within: NDArray[np.bool_] = (values >= low - TOLERANCE) & (values <= high + TOLERANCE)
    return ~within  # NaN is within nothing
