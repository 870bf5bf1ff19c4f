"""Episodes that begin after recorded rows; `edge.lab.episodes` draws their references and rooms.

References are drawn anew for every episode; those that controllers are compared on are fixed files, and none
of them is drawn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.lab.episodes import EpisodeSettings, draw_ambient, draw_reference
from edge.models.policy_observation import AIR_ROWS, INPUT_ROWS, Recent, observe
from training.data.pairs import split_all, stretches

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


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EpisodeStart:
    """Measured rows [rows] that an episode begins after, the last of them now."""

    temp: Floats
    ambient: Floats
    duty: Floats
    fan: Floats


@dataclass(frozen=True, slots=True)
class Episode:
    """reference, ambient : [steps + 1] [°C]; the last ones are only looked at."""

    reference: Floats
    ambient: Floats
    start: EpisodeStart


class Episodes(Protocol):
    """A source of episodes, all of one length."""

    @property
    def steps(self) -> int:
        """Length of every episode [steps of a minute]."""
        ...

    def draw(self, rng: np.random.Generator) -> Episode:
        """Return an episode of `steps`; all chance comes from `rng`."""
        ...


class DrawnEpisodes:
    """Random references and rooms; starts are windows of the training parts of recorded runs.

    Errors : DataError where no stretch is long enough
    """

    def __init__(
        self, runs: Sequence[RecordedRun], rows: int, settings: EpisodeSettings | None = None
    ) -> None:
        """rows : of a start"""
        self._settings, self._rows = settings or EpisodeSettings(), rows
        self._stretches = [stretch for stretch in stretches(split_all(runs).train) if len(stretch[0]) >= rows]
        if not self._stretches:
            raise DataError(f"no training run has {rows} rows in which nothing is missing")

    @property
    def steps(self) -> int:
        """Number of steps in an episode."""
        return self._settings.steps

    def draw(self, rng: np.random.Generator) -> Episode:
        """Draw a new episode."""
        ambient = draw_ambient(rng, self._settings)
        reference = draw_reference(rng, self._settings, float(ambient.mean()))
        return Episode(np.append(reference, reference[-1]), ambient, self._start(rng, float(ambient[0])))

    def _start(self, rng: np.random.Generator, ambient_c: float) -> EpisodeStart:
        """Draw a window whose room ends at `ambient_c`: air and room are shifted by the same."""
        stretch = self._stretches[rng.integers(len(self._stretches))]
        first = rng.integers(len(stretch[0]) - self._rows + 1)
        temp, ambient, duty, fan = (column[first : first + self._rows] for column in stretch)
        moved = ambient_c - ambient[-1]
        return EpisodeStart(temp + moved, ambient + moved, duty, fan)
