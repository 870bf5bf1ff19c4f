"""Observations out of recorded runs: what a policy would have seen at each row."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from edge.formats.run_file import RecordedRun
from edge.models.policy_observation import AIR_ROWS, INPUT_ROWS, Recent, observe
from training.data.pairs import stretches

AHEAD_ROWS = (1, 5, 10, 20, 30)  # the reference is the air so much later: errors of a box that is driven


def recorded_observations(runs: Sequence[RecordedRun]) -> NDArray[np.float32]:
    """At each row of the runs that has enough before and behind it, for each of AHEAD_ROWS; [n, features]."""
    tables = [observe(recent) for ahead in AHEAD_ROWS for recent in _recents(runs, ahead)]
    return np.concatenate(tables).astype(np.float32)


def _recents(runs: Sequence[RecordedRun], ahead: int) -> Iterator[Recent]:
    windows = np.lib.stride_tricks.sliding_window_view
    for temp, ambient, duty, fan in stretches(runs):
        count = len(temp) - INPUT_ROWS - ahead
        if count > 0:
            yield Recent(
                air=windows(temp, AIR_ROWS)[INPUT_ROWS - AIR_ROWS + 1 :][:count],
                duty=windows(duty, INPUT_ROWS)[:count],
                fan=windows(fan, INPUT_ROWS)[:count],
                ambient=ambient[INPUT_ROWS:][:count],
                reference=temp[INPUT_ROWS + ahead :][:count],
            )
