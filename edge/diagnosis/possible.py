"""Whether an effect's values can be: in a box of this size, and seen in runs of this length."""

from collections.abc import Mapping

import numpy as np

from edge.diagnosis.trial import Fitted
from edge.diagnosis.unknowns import SDS_95
from edge.twin.effects.library import EFFECTS
from edge.twin.recorded import Recorded
from edge.twin.value import Value

WATER_J_M3_K = 4.18e6  # nothing that fits into a box stores more heat
NOTHING_AT = {"eta": 1.0, "eps_f": 1.0, "u_sat": 1.0, "kC": 1.0}  # other values do nothing at 0
PERIODS = 3.0  # of the longest run: a slower time constant can't be seen in it


def impossible(name: str, fitted: Fitted, runs: Recorded, step_s: float) -> list[str]:
    """What can't be of its values in this box and in runs of this length."""
    values = fitted.file.effects.get(name, {})
    geometry = fitted.file.twin().geometry
    stores = {key: values[key].value for key in ("C_s", "C_w") if key in values}
    if "kC" in values:
        stores["kC"] = values["kC"].value * geometry.air_capacity_j_k
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


def none_at_all(name: str, fitted: Fitted) -> list[str]:
    """Values that may as well be nothing, within their 95 % interval."""
    if len(EFFECTS[name].parameters) > 1:
        return []
    found = []
    for i, item in enumerate(fitted.free):
        if item.place[:2] == ("effects", name) and not item.log:
            x, sd = float(fitted.coordinates[i]), float(np.sqrt(max(fitted.covariance[i, i], 0.0)))
            low, high = item.value(x - SDS_95 * sd), item.value(x + SDS_95 * sd)
            if low <= NOTHING_AT.get(item.place[2], 0.0) <= high:
                found.append(f"{item.place[2]} is {low:.3g} to {high:.3g}, which may as well be no effect")
    return found


def _times(name: str, values: Mapping[str, Value]) -> dict[str, float]:
    numbers = {key: value.value for key, value in values.items()}
    if name == "soil_mass":
        return {"C_s / G_s": numbers["C_s"] / numbers["G_s"]}
    if name == "wall_mass":
        return {"C_w / G": numbers["C_w"] / (numbers["G_in"] + numbers["G_out"])}
    return {key: value for key, value in numbers.items() if key.startswith("tau_")}
