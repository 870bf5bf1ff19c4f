"""How well an experiment would separate rivals: expected log odds of the true one over each other.

The true twin's temperatures less the other's, less what the other makes up for by moving its free values as
far as the runs so far let it: half the sum of squares that is left, in standard deviations of an error, is by
how much it falls behind (a T-optimal design, Atkinson & Fedorov 1975, Biometrika 62, with the runs so far as
prior; linear in the values, about where they were fitted).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.sequence import DAY_S, SequenceInputs, Surroundings
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, simulate
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
EXACT_SD = 0.005  # of a calibrated value, in its coordinate: half a percent
FAR_K = 10.0  # from the room, where no box rests: it hardly loses heat by this model


@dataclass(frozen=True, slots=True)
class RivalPair:
    """Two fitted sets that differ in one effect.

    models : their positions among the models; names : of the effect that each has in the same place
    likelihoods : of each by the runs so far, over that of the best set
    """

    models: tuple[int, int]
    names: tuple[str, str]
    likelihoods: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """Rivals in their surroundings, planned in rows of `row_s`.

    models : the best one first; start_c : of every experiment, the best model's rest
    """

    models: tuple[FittedTwin, ...]
    pairs: tuple[RivalPair, ...]
    around: Surroundings
    row_s: float
    start_c: float

    def predicted_c(self, inputs: SequenceInputs) -> Floats:
        """Return the temperatures by each model [M, B, N]."""
        runs = self.around.record(inputs, self.start_c)
        return np.stack([_free_run(item.file.twin(), runs) for item in self.models])

    def log_odds(self, inputs: SequenceInputs) -> Floats:
        """Return the expected log odds if a pair's first is true, and if its second is, [pairs, 2, B]."""
        shown = self.predicted_c(inputs)
        found = np.empty((len(self.pairs), 2, len(inputs.fan)))
        for other, item in enumerate(self.models):
            moves = np.where(inputs.within, self._moves(item, inputs, shown[other]), 0.0) / item.error_k
            for i, pair in enumerate(self.pairs):
                if other in pair.models:
                    way = 1 - pair.models.index(other)
                    missed_k = shown[pair.models[way]] - shown[other]
                    found[i, way] = _remainder(np.where(inputs.within, missed_k, 0.0) / item.error_k, moves)
        return found

    def by_calibration(self, place: Place) -> Floats:
        """Return the expected log odds of knowing one value exactly, without an experiment, [pairs, 2]."""
        at = [[item.place for item in model.free].index(place) for model in self.models]
        value = np.array([model.x[i] for model, i in zip(self.models, at, strict=True)])
        variance = np.array([model.covariance[i, i] for model, i in zip(self.models, at, strict=True)])
        one, two = np.array([pair.models for pair in self.pairs]).T
        others = np.column_stack([variance[two], variance[one]])
        return np.asarray(0.5 * (value[one] - value[two])[:, None] ** 2 / (EXACT_SD**2 + others))

    def _moves(self, item: FittedTwin, inputs: SequenceInputs, shown: Floats) -> Floats:
        """Return how a model's temperatures move with its values and starts, by a standard deviation each."""
        plain = self.around.record(inputs, self.start_c)
        guess = replace(plain, temp=np.concatenate([plain.temp[:, :1], shown], axis=1))
        rests = np.ones(len(shown), dtype=bool)
        runs = FitRuns(guess, item.error_k, rests, np.full(len(rests), self.around.guessed))
        found = simulate([(item.file, item.free, item.x)], runs)[0]
        values = np.einsum("kj,kbn->jbn", _root(item.covariance), found.slopes)
        # A run has a start, a power and perhaps a room of its own.
        return np.concatenate([values, found.starts * found.sds.T[:, :, None]])


def separation(
    models: Sequence[FittedTwin], pairs: Sequence[RivalPair], around: Surroundings, row_s: float
) -> Separation:
    """Return the rivals at the plan's rows. The light has a part only where a model needs it."""
    placed = tuple(replace(item, file=replace(item.file, sample_s=row_s)) for item in models)
    twins = [item.file.twin() for item in placed]
    around = replace(around, has_light=around.has_light and any("light" in twin.needs for twin in twins))
    off = np.zeros((1, int(np.ceil(DAY_S / row_s))))
    idle = SequenceInputs(row_s, ("",), off, off, off + around.fan_on, off, off == 0.0)
    rest_c = float(_free_run(twins[0], around.record(idle, around.room_c))[0, -1])
    start_c = rest_c if abs(rest_c - around.room_c) < FAR_K else around.room_c
    return Separation(placed, tuple(pairs), around, row_s, start_c)


def _free_run(twin: BoxTwin, runs: RunBatch) -> Floats:
    """Return the temperatures from rest at each run's first, the heater off before, [B, N]."""
    start = at_rest(twin, runs.temp[:, 0], runs.ambient[:, 0])
    return twin.rollout(start, runs.duty, runs.fan, runs.ambient, conditions=runs.conditions)


def _root(covariance: Floats) -> Floats:
    """Return L with L L' = covariance, which may have directions that are known exactly."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _remainder(misses: Floats, moves: Floats) -> Floats:
    """Return half the sum of squares of misses [B, N] that moves [K, B, N] of size 1 cannot make up for."""
    along = np.einsum("kbn,bn->bk", moves, misses)
    normal = np.eye(len(moves)) + np.einsum("kbn,jbn->bkj", moves, moves)
    made_up = np.einsum("bk,bk->b", along, np.linalg.solve(normal, along[:, :, None])[:, :, 0])
    return np.asarray(0.5 * np.maximum((misses**2).sum(axis=1) - made_up, 0.0))
