"""What heat and room do to the air, from rows of the history, by least squares."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

ROWS_MIN = 15
REACH_MIN = 5.0  # an error shall be gone after about so long


@dataclass(frozen=True, slots=True)
class MinuteGains:
    """Of a minute: the share of its excess over the room that air loses, and the rise by full heat [K]."""

    loss: float
    heat: float

    def duty(self, target: float, current: float, ambient: float) -> float:
        """That holds the target, and meanwhile brings the air there."""
        return (self.loss * (target - ambient) + (target - current) / REACH_MIN) / self.heat


COMMON_SENSE = MinuteGains(loss=0.05, heat=1.0)  # 100 W hold such a box about 20 K above its room


def estimate(result: Mapping[str, Any]) -> MinuteGains:
    """From the rows of `agent.QUERY`, newest first; common sense where they tell too little."""
    rows = [row for row in result["rows"] if None not in row][::-1]
    if len(rows) < ROWS_MIN:
        return COMMON_SENSE
    _, step_s, air, ambient, duty, fan = np.array(rows, dtype=float).T
    minutes = step_s[:-1] / 60.0
    rise, excess = np.diff(air) / minutes, (air - ambient)[:-1]
    terms = np.column_stack([-excess, duty[:-1], -excess * fan[:-1]])
    gains, *_ = np.linalg.lstsq(terms, rise, rcond=None)
    loss, heat = float(gains[0]), float(gains[1])
    plausible = math.isfinite(loss + heat) and 0.005 < loss < 0.5 and 0.1 < heat < 10.0
    return MinuteGains(loss, heat) if plausible else COMMON_SENSE
