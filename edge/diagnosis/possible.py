"""Checks that an effect's values are possible in a greenhouse of this
size and visible in runs of this length.
"""

import numpy as np

from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.unknowns import SDS_95
from edge.twin.effects.effect import ParameterKind, Values
from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch

WATER_J_M3_K = 4.18e6  # nothing that fits into a box stores more heat
LAGS = (ParameterKind.AIR_LAG, ParameterKind.LAG)
PERIODS = 3.0  # of the longest run: a slower time constant can't be seen in it


def impossible(name: str, fitted: FittedTwin, runs: RunBatch, step_s: float) -> list[str]:
    """Return sentences about the impossible values of an effect in this
    greenhouse and in runs of this length.
    """
    values = {key: value.value for key, value in fitted.file.effects.get(name, {}).items()}
    geometry = fitted.file.twin().geometry
    stores = _stores(name, values, geometry.air_capacity_j_k)
    full = WATER_J_M3_K * geometry.volume_m3
    said = [
        f"{key} would store {store / full:.2g} times the heat of the box full of water"
        for key, store in stores.items()
        if store > full
    ]
    longest_s = float(runs.measured.sum(axis=1).max()) * step_s
    for key, tau in _times(name, values).items():
        if tau > PERIODS * longest_s:
            said.append(
                f"a time constant of {tau / 3600.0:.2g} h can't be seen in {longest_s / 3600.0:.2g} h ({key})"
            )
    pairs = zip(fitted.free, map(float, fitted.coordinates), strict=True)
    own = [(item, x) for item, x in pairs if item.place[:2] == ("effects", name)]
    said += [f"{item.place[2]} is as far as it can go" for item, x in own if item.is_at_bound(x)]
    return said


def none_at_all(name: str, fitted: FittedTwin) -> list[str]:
    """Values that may as well be nothing, within their 95 % interval."""
    if len(EFFECTS[name].parameters) > 1:
        return []
    found = []
    for i, item in enumerate(fitted.free):
        if item.place[:2] == ("effects", name) and not item.log:
            x, sd = float(fitted.coordinates[i]), float(np.sqrt(max(fitted.covariance[i, i], 0.0)))
            low, high = item.value(x - SDS_95 * sd), item.value(x + SDS_95 * sd)
            if low <= EFFECTS[name].parameter(item.place[2]).nothing_at <= high:
                found.append(f"{item.place[2]} is {low:.3g} to {high:.3g}, which may as well be no effect")
    return found


def _stores(name: str, values: Values, air_j_k: float) -> dict[str, float]:
    """Heat capacities [J/K] by parameter."""
    found = {}
    for key, value in values.items():
        parameter = EFFECTS[name].parameter(key)
        if parameter.unit == "J/K":
            found[key] = value
        if parameter.kind is ParameterKind.AIR_CAPACITIES:
            found[key] = value * air_j_k
    return found


def _times(name: str, values: Values) -> dict[str, float]:
    """Time constants [s] by parameter or formula."""
    found = {key: value for key, value in values.items() if EFFECTS[name].parameter(key).kind in LAGS}
    if values and (formula := EFFECTS[name].time_constant) is not None:
        found[formula[0]] = formula[1](values)
    return found
