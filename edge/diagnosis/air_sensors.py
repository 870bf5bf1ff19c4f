"""Two sensors in the air: the twin's air is their mean, and how far they are apart is said."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge.formats.run_file import RecordedRun

SECOND = "temp_air_second_c"
MUCH_K = 0.5  # farther apart while it heats than while it does not: more than two sensors of one air

Named = tuple[str, RecordedRun]


def average(train: Sequence[Named], test: Sequence[Named]) -> tuple[list[Named], list[Named], list[str]]:
    """Return the recordings with the mean of both air sensors as their air, and sentences that say
    so. Runs without both sensors in every file stay as they are.
    """
    every = [*train, *test]
    with_second = [run for _, run in every if np.isfinite(_apart(run)).any()]
    if not with_second:
        return list(train), list(test), []
    if len(with_second) < len(every):
        return list(train), list(test), [f"{SECOND} is not known in every run and is passed over"]
    return (
        [(name, _mean(run)) for name, run in train],
        [(name, _mean(run)) for name, run in test],
        [_note([run for _, run in train])],
    )


def _apart(run: RecordedRun) -> np.ndarray:
    return np.asarray(run.columns.get(SECOND, np.full(len(run), np.nan)) - run.columns["temp_air_c"])


def _mean(run: RecordedRun) -> RecordedRun:
    """Return a run with the mean of both sensors. Where one has no reading, the other
    replaces it, shifted by their usual difference.
    """
    first, second, apart = run.columns["temp_air_c"], run.columns[SECOND], _apart(run)
    half_k = 0.5 * float(np.nanmedian(apart))
    either = np.where(np.isfinite(first), first + half_k, second - half_k)
    air = np.where(np.isfinite(apart), 0.5 * (first + second), either)
    kept = {key: values for key, values in run.columns.items() if key != SECOND}
    return replace(run, columns={**kept, "temp_air_c": air})


def _note(runs: Sequence[RecordedRun]) -> str:
    apart = np.concatenate([_apart(run) for run in runs])
    heats = np.concatenate([run.columns["heater_duty"] > 0.0 for run in runs])
    known = np.isfinite(apart)
    said = (
        f"the air is the mean of two sensors: the second shows {np.nanmedian(apart):.2g} K more than the "
        f"first in the median, and is {np.nanmax(np.abs(apart)):.2g} K from it at most"
    )
    if not (known & heats).any() or not (known & ~heats).any():
        return said
    on_k, off_k = (float(np.median(apart[known & mask])) for mask in (heats, ~heats))
    if abs(on_k - off_k) < MUCH_K:
        return said
    return (
        f"{said}; {on_k:.2g} K while the heater is on and {off_k:.2g} K while it is off: the air is not "
        "mixed, or one of them is warmed by the heater itself"
    )
