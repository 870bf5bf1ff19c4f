"""pysindy on a case: a sparse discrepancy model (Kaheman, Kaiser, Strom et al. 2019).

The owner's twin is fitted first. What it then misses over one step, as heat, is regressed on TERMS, each in
units of its size and named by the effect that it would be. Sequentially thresholded least squares
(`pysindy.STLSQ`) drops small ones, with the largest threshold that does nearly as well as the best one on
rows left out.

What it can't name, whatever is chosen: an effect whose term is that of another (`sensor_lag` and
`heater_deadtime` are `heater_lag`, `short_circuit` is `fan_effectiveness`), and anything outside the library:
it never says `unknown`. It has no probabilities, no values and no forecast.
"""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pysindy
from numpy.typing import NDArray

from edge.formats.run_file import RecordedRun, read_run, resample
from edge.twin.fit import fit_twin
from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
BENDS_ABOVE = 0.6  # duty
SLOW_S = 3600.0  # memory of a body that is guessed
THRESHOLDS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8, 10.0)  # share of the size; the last leaves nothing
HELD_OUT = 4  # a quarter of the rows
NEARLY = 1.1
TERMS: Mapping[str, Callable[[Columns], Floats]] = {  # of columns at one row, `before` and `slow` included
    "infiltration": lambda c: (1.0 - c["fan"]) * (c["temp"] - c["room"]),
    "fan_effectiveness": lambda c: c["fan"] * (c["temp"] - c["room"]),
    "longwave_radiation": lambda c: (c["temp"] - c["room"]) * np.abs(c["temp"] - c["room"]),
    "heater_sag": lambda c: c["duty"] ** 2,
    "heater_saturation": lambda c: np.maximum(c["duty"] - BENDS_ABOVE, 0.0),
    "heater_lag": lambda c: c["duty"] - c["duty_before"],
    "fan_spinup": lambda c: (c["fan"] - c["fan_before"]) * (c["temp"] - c["room"]),
    "soil_mass": lambda c: c["temp"] - c["slow"],
    "wall_mass": lambda c: c["slow"] - c["room"],
    "constant_heat": lambda c: np.ones_like(c["temp"]),
    "led_gain": lambda c: c["light"],
}


def diagnose(folder: Path) -> dict[str, Any]:
    """Return the answer, as much of a diagnosis as is scored. Errors: DataError"""
    file = read_twin_file(folder / "twin.yaml")
    runs = [read_run(path) for path in sorted(folder.glob("train_*.csv"))]
    twin = fit_twin(file, runs).file.twin()
    parts = [_misses(twin, columns(run, file.sample_s)) for run in runs]
    terms, heat_w = (np.concatenate(column) for column in zip(*parts, strict=True))
    names = sparse(terms, heat_w)
    return {
        "verdict": "named" if names else "nothing_missing",
        "effects": [{"name": name, "parameters": {}} for name in names],
        "doubtful": [],
        "depends_on": [],
        "gap": {"before": {"test": None}, "after": {"test": None}},
        "left_out": {"test_k": {}},
        "twin_after": None,
        "against_adopting": [],
    }


def columns(run: RecordedRun, step_s: float) -> dict[str, Floats]:
    """Return what TERMS see: what was not recorded is 0, the room as the first reading."""
    found = resample(run, step_s).columns
    temp = found["temp_air_c"]
    duty, fan, light = (found.get(name, np.zeros(len(temp))) for name in ("heater_duty", "fan_on", "light"))
    slow, left = temp.copy(), np.exp(-step_s / SLOW_S)
    for k in range(1, len(slow)):
        slow[k] = left * slow[k - 1] + (1.0 - left) * temp[k]
    return {
        "temp": temp, "room": found.get("temp_ambient_c", np.full(len(temp), temp[0])), "slow": slow,
        "duty": duty, "duty_before": np.append(duty[:1], duty[:-1]), "light": light,
        "fan": fan, "fan_before": np.append(fan[:1], fan[:-1]),
    }  # fmt: skip


def _misses(twin: BoxTwin, run: Columns) -> tuple[Floats, Floats]:
    """Terms at each row but the last, [rows, terms], and the heat that the twin misses over its step [W]."""
    now = {name: values[:-1] for name, values in run.items()}
    start = np.repeat(now["temp"][:, None], len(twin.states), axis=1)
    shown = twin.rollout(start, now["duty"][:, None], now["fan"][:, None], now["room"][:, None])[:, 0]
    heat_w = (run["temp"][1:] - shown) * twin.system.air_capacity_j_k / twin.step_s
    terms = np.stack([term(now) for term in TERMS.values()], axis=1)
    known = np.isfinite(heat_w) & np.isfinite(terms).all(axis=1)
    return terms[known], heat_w[known]


def sparse(terms: Floats, heat_w: Floats) -> list[str]:
    """Return the names of the chosen terms, the largest first."""
    size = np.sqrt((terms**2).mean(axis=0))
    used = np.flatnonzero(size > 0.0)
    design, target = terms[:, used] / size[used], heat_w / (np.sqrt((heat_w**2).mean()) or 1.0)
    kept = len(target) - len(target) // HELD_OUT
    tried = {threshold: _fit(design[:kept], target[:kept], threshold) for threshold in THRESHOLDS}
    missed = {key: float(((target - design @ own)[kept:] ** 2).sum()) for key, own in tried.items()}
    best = _fit(design, target, max(key for key in tried if missed[key] <= NEARLY * min(missed.values())))
    names = list(TERMS)
    return [names[used[j]] for j in np.argsort(-np.abs(best)) if best[j]]


def _fit(design: Floats, target: Floats, threshold: float) -> Floats:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a threshold that drops every term is expected here
        found = pysindy.STLSQ(threshold=threshold, alpha=1e-3).fit(design, target[:, None])
    return np.asarray(found.coef_, dtype=np.float64).ravel()
