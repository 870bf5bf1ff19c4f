"""Training pairs of runs, never across two: windows for the LSTM, transitions for the hybrids; the scaler."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edge.formats.run_file import RecordedRun
from training.data.datasets import Split, split

CONSTANT = 1e-6  # a standard deviation below this is no spread to divide by


def scaler(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of each column of `rows` [n, k], both [k]; 1 where a column is constant."""
    exact = rows.double()  # or a constant column spreads by rounding
    mean, deviation = exact.mean(dim=0), exact.std(dim=0, correction=0)
    return mean, torch.where(deviation > CONSTANT, deviation, 1.0)


Floats = NDArray[np.float64]
INPUTS = ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")


@dataclass(frozen=True, slots=True)
class Transitions:
    """One measured step each, all [n]: what held from a row to the next, and the temperatures at both."""

    temp: Floats  # [°C]
    ambient: Floats  # [°C]
    duty: Floats  # 0..1
    fan: Floats  # 0 or 1
    following: Floats  # [°C], one step later


def split_all(runs: Sequence[RecordedRun]) -> Split:
    """All training parts and all validation parts. Errors: DataError for a test run."""
    splits = [split(run) for run in runs]
    return Split([part for one in splits for part in one.train], [p for one in splits for p in one.validate])


def transitions(runs: Sequence[RecordedRun]) -> Transitions:
    """Every pair of rows in which nothing is missing."""
    return Transitions(
        *np.concatenate(
            [np.stack([*(column[:-1] for column in s), s[0][1:]], axis=-1) for s in stretches(runs)]
        ).T
    )


def windows(runs: Sequence[RecordedRun], length: int) -> tuple[Floats, Floats]:
    """Windows [n, length, 3] of (T, u_h, u_f) and the temperature one step later [n] [°C]."""
    inputs: list[Floats] = []
    following: list[Floats] = []
    for temp, _, duty, fan in stretches(runs):
        table = np.stack([temp, duty, fan], axis=-1)
        for first in range(len(table) - length):
            inputs.append(table[first : first + length])
            following.append(table[first + length, 0])
    return np.array(inputs).reshape(-1, length, 3), np.array(following)


def stretches(runs: Sequence[RecordedRun]) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    """Columns (T, T_amb, duty, fan) of two or more rows that follow each other with nothing missing."""
    for run in runs:
        table = np.stack([run.columns[name] for name in INPUTS])
        gaps = np.flatnonzero(~np.isfinite(table).all(axis=0))
        for first, last in zip(np.append(-1, gaps) + 1, np.append(gaps, table.shape[1]), strict=True):
            if last - first > 1:
                temp, ambient, duty, fan = table[:, first:last]
                yield temp, ambient, duty, fan
