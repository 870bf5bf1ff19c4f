"""Simple models that a twin has to beat: one mass, a heater that lags, two masses, ARX of order 2 to 4.

Each is fitted by least squares to the same rows: the first three over free runs, ARX over one step
(Ljung 1999, System Identification, ch. 10).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
ONE_MASS = "one mass"
ROWS_A_WEIGHT = 4  # fewer tell nothing
LOSING, STORING = "wall_loss", "extra_capacity"
ORDERS = (2, 3, 4)
FAN = {"exhaust": ("fan_effectiveness",), "stirring": ("stirred_loss",)}  # by its role


def simple_sets() -> dict[str, frozenset[str]]:
    """Return what each simple model has beside one mass, by name."""
    return {
        ONE_MASS: frozenset(),
        "heater lag": frozenset({"heater_lag"}),
        "two masses": frozenset({"soil_mass"}),
    }


def open_file(file: TwinFile, runs: RunBatch) -> TwinFile:
    """Return one mass, with all values to be fitted from where a file has them."""
    fan = FAN.get(file.fan_role, ()) if np.ptp(runs.fan) > 0.0 else ()
    effects = {
        name: {item.name: Value(_begin(file, name, item.name), fit=True) for item in EFFECTS[name].parameters}
        for name in (LOSING, STORING, *fan)
    }
    geometry = {name: Value(value.value) for name, value in file.geometry.items()}
    return replace(file, geometry=geometry, effects=effects)


def _begin(file: TwinFile, name: str, parameter: str) -> float:
    known = file.effects.get(name, {}).get(parameter)
    return file.usual(("effects", name, parameter)).start if known is None else known.value


def arx_weights(order: int, runs: RunBatch, seen: Mask) -> Floats | None:
    """Fit T[k+1] = sum a_i T[k+1-i] + sum b_i u[k+1-i] + c fan (T - T_amb)[k] + d T_amb[k] + e.

    seen : [B, N], temperatures after a row that it is fitted to
    Returns : [2 order + 3], None of too few rows
    """
    told = np.concatenate([np.isfinite(runs.temp[:, :1]), seen], axis=1)
    places = [
        (i, k)
        for i in range(len(told))
        for k in range(order - 1, told.shape[1] - 1)
        if told[i, k - order + 1 : k + 2].all()
    ]
    if len(places) < ROWS_A_WEIGHT * (2 * order + 3):
        return None
    inputs = np.stack([_inputs(runs, runs.temp, i, k, order) for i, k in places])
    wanted = np.array([runs.temp[i, k + 1] for i, k in places])
    return np.asarray(np.linalg.lstsq(inputs, wanted, rcond=1e-10)[0])


def arx_errors(weights: Floats | None, runs: RunBatch, seen: Mask) -> Floats:
    """Measured minus free run where nothing is seen, [B, N]; 0 where it is, infinite for no weights."""
    if weights is None:
        return np.full(runs.duty.shape, np.inf)
    order, temp = (len(weights) - 3) // 2, runs.temp.copy()
    for i in range(len(temp)):
        for k in range(order - 1, temp.shape[1] - 1):
            if not seen[i, k]:
                with np.errstate(over="ignore", invalid="ignore"):
                    temp[i, k + 1] = _inputs(runs, temp, i, k, order) @ weights
    return np.asarray(runs.temp[:, 1:] - temp[:, 1:])


def _inputs(runs: RunBatch, temp: Floats, i: int, k: int, order: int) -> Floats:
    past = slice(k - order + 1, k + 1)
    excess = temp[i, k] - runs.ambient[i, k]
    return np.concatenate(
        [temp[i, past], runs.duty[i, past], [runs.fan[i, k] * excess, runs.ambient[i, k], 1.0]]
    )
