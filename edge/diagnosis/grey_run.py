"""Recordings as grey boxes take them: equal steps, a step that suits them, what noise a reading has."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.formats.run_file import RecordedRun, resample

Floats = NDArray[np.float64]
ROWS_MAX = 800  # of all runs together; thinner rows cost accuracy, more of them time
GAINS = ("light", "solar_w_m2")  # columns that may heat in proportion
STILL_ROWS = 4  # at the begin of a run, that tell whether it rests
STILL_SHARE, COLD_SHARE = 0.01, 0.1  # of all that the air moves by: so still, so near its coldest
SDS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class GreyRun:
    """One recording at equal steps.

    temp : [N] air [°C], NaN where not measured; duty : [N] 0..1, each over the step that begins there
    room : [N] [°C], or None; others : [N] each, heat in proportion to them: sun, light; fan : [N] 0..1
    at_rest : it begins in balance with its room
    """

    temp: Floats
    duty: Floats
    room: Floats | None = None
    others: tuple[Floats, ...] = ()
    fan: Floats | None = None
    at_rest: bool = False

    def until(self, rows: int) -> "GreyRun":
        """Return its first rows."""
        room = None if self.room is None else self.room[:rows]
        fan = None if self.fan is None else self.fan[:rows]
        others = tuple(column[:rows] for column in self.others)
        return GreyRun(self.temp[:rows], self.duty[:rows], room, others, fan, self.at_rest)

    @property
    def first_c(self) -> float:
        """Mean of the first three readings."""
        return float(self.temp[np.isfinite(self.temp)][:3].mean())


def grey_runs(runs: Sequence[RecordedRun], step_s: float, noise_k: float) -> list[GreyRun]:
    """Return recordings at one step, each with the columns that all of them have.

    noise_k : of a reading, by which a run that begins at rest is recognised
    """
    every = [resample(run, step_s).columns for run in runs]
    shared = {name for name in every[0] if all(_is_known(columns, name) for columns in every)}
    moving = [
        name for name in GAINS if name in shared and any(np.ptp(columns[name]) > 0.0 for columns in every)
    ]
    found = []
    for columns in every:
        temp = columns["temp_air_c"]
        found.append(
            GreyRun(
                temp,
                np.nan_to_num(columns["heater_duty"]),
                _fill_holes(columns["temp_ambient_c"]) if "temp_ambient_c" in shared else None,
                tuple(_fill_holes(columns[name]) for name in moving),
                np.nan_to_num(columns["fan_on"]) if "fan_on" in shared else None,
                _rests(temp[np.isfinite(temp)], noise_k),
            )
        )
    return found


def _is_known(columns: Mapping[str, Floats], name: str) -> bool:
    return name in columns and bool(np.isfinite(columns[name]).any())


def _fill_holes(values: Floats) -> Floats:
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known])


def _rests(known: Floats, noise_k: float) -> bool:
    """Return whether the first readings stand still near the coldest of all. known : readings in a row"""
    moved_k, first = float(np.ptp(known)), known[:STILL_ROWS]
    is_still = float(np.ptp(first)) <= max(STILL_SHARE * moved_k, SDS * noise_k)
    return is_still and float(first[0]) <= float(known.min()) + max(COLD_SHARE * moved_k, SDS * noise_k)


def usual_step_s(runs: Sequence[RecordedRun]) -> float:
    """Return the recordings' own step, or one that leaves ROWS_MAX rows."""
    times = [run.columns["time_s"] for run in runs]
    own_s = float(np.median(np.concatenate([np.diff(time_s) for time_s in times])))
    length_s = sum(float(time_s[-1] - time_s[0]) for time_s in times)
    return own_s * max(1, int(np.ceil(length_s / own_s / ROWS_MAX)))


def reading_noise_k(runs: Sequence[RecordedRun]) -> float:
    """Return the noise of a reading as the recordings show it: by second differences, or by its steps.

    Their median leaves out what inputs do. A reading in steps has at least their rounding's error.
    """
    second, steps = [], []
    for run in runs:
        known = run.columns["temp_air_c"][np.isfinite(run.columns["temp_air_c"])]
        first = np.diff(known)
        second.append(np.abs(np.diff(first)))
        steps.append(np.abs(first[first != 0.0]))
    moved = np.concatenate(steps)
    rounding_k = float(moved.min()) / 12**0.5 if len(moved) else 0.0
    spread_k = float(np.median(np.concatenate(second))) / 0.6745 / 6**0.5
    return max(spread_k, rounding_k, 1e-3)
