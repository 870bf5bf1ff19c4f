"""The offset of a box's sensor at rest: what it reads beside the room's sensor before anything warms the box.

Two sensors of ±0.5 K each differ by what a tenth of a box's loss makes. Tests of an hour do not tell one from
the other, but they begin at rest.
"""

from dataclasses import replace

import numpy as np

from edge.formats.run_file import RecordedRun
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

BIAS = "sensor_bias"
LEAST_ROWS = 6
STILL_K = 0.3  # by which either moves at rest: a step of a coarse sensor
FAR_K = 1.0  # more is no error of two sensors
SD_K = 0.2  # what warms or cools a box at rest: plants, electronics, a draught
LEAST_K = 0.01  # so that its spread can be a share of it


def with_rest_offset(file: TwinFile, run: RecordedRun) -> TwinFile:
    """Return the twin with an uncertain bias of its sensor, where the run begins at rest."""
    offset_k = rest_offset_k(run)
    if BIAS in file.effects or not abs(offset_k) <= FAR_K:
        return file
    bias_k = float(np.copysign(max(abs(offset_k), LEAST_K), offset_k))
    (parameter,) = EFFECTS[BIAS].parameters
    own = {parameter.name: Value(float(f"{bias_k:.3g}"), rel_sd=float(f"{SD_K / abs(bias_k):.3g}"))}
    return replace(file, effects={**file.effects, BIAS: own})


def rest_offset_k(run: RecordedRun) -> float:
    """Return the air less the room before the first heat or wind; NaN where the run begins otherwise [K]."""
    none = np.zeros(len(run))
    duty, fan = (np.nan_to_num(run.columns.get(name, none)) for name in ("heater_duty", "fan_on"))
    acts = np.flatnonzero((duty > 0.0) | (fan > 0.0))
    rows = int(acts[0]) if len(acts) else len(run)
    air = run.columns["temp_air_c"][:rows]
    room = run.columns.get("temp_ambient_c", none + np.nan)[:rows]
    seen = np.isfinite(air) & np.isfinite(room)
    if seen.sum() < LEAST_ROWS or max(np.ptp(air[seen]), np.ptp(room[seen])) > STILL_K:
        return float("nan")
    return float(np.mean(air[seen] - room[seen]))
