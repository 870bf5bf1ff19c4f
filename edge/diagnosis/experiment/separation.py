"""How well an experiment would tell rivals apart: expected log odds of the true one over each other.

The true twin's temperatures less the other's, less what the other makes up for by moving its free values as
far as the runs so far let it: half the sum of squares that is left, in standard deviations of an error, is by
how much it falls behind (a T-optimal design, Atkinson & Fedorov 1975, Biometrika 62, with the runs so far as
prior; linear in the values, about where they were fitted).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.rivals import Rivals
from edge.diagnosis.experiment.sequence import SequenceInputs
from edge.diagnosis.experiment.surroundings import Surroundings, free_run, resting_c
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, simulate
from edge.twin.twin_file import Place

Floats = NDArray[np.float64]
EXACT_SD = 0.005  # of a calibrated value, in its coordinate: half a percent


@dataclass(frozen=True, slots=True, eq=False)
class PredictedRuns:
    """Temperatures that each model predicts for the experiments, and how they move with its values.

    shown : [M, B, N] [°C]; moves : of each model [K, B, N], by a standard deviation each [K]
    """

    shown: Floats
    moves: tuple[Floats, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """Rivals in their surroundings, planned in rows of `row_s`.

    start_c : of every experiment, the best model's rest
    """

    rivals: Rivals
    models: tuple[FittedTwin, ...]
    around: Surroundings
    row_s: float
    start_c: float

    def predicted_c(self, inputs: SequenceInputs) -> Floats:
        """Temperatures by each model [M, B, N]."""
        return np.stack(
            [free_run(item.file.twin(), self.around.record(inputs, self.start_c)) for item in self.models]
        )

    def log_odds(self, inputs: SequenceInputs, exact: Place | None = None) -> Floats:
        """Return the expected log odds of each experiment for each pair, [pairs, B].
        exact : a value that is calibrated first
        """
        predicted = self._predict(inputs)
        found = np.empty((len(self.rivals.pairs), len(inputs.fan)))
        for other in range(len(self.models)):
            places = [i for i, pair in enumerate(self.rivals.pairs) if pair.other == other]
            trues = [self.rivals.pairs[i].true for i in places]
            if places:
                found[places] = self._against(other, trues, predicted, inputs.within, exact)
        return found

    def by_calibration(self, place: Place) -> Floats:
        """Return the expected log odds of knowing one value exactly, without an experiment [pairs]."""
        found = []
        for pair in self.rivals.pairs:
            other = self.models[pair.other]
            column, miss = _calibration(self.models[pair.true], other, place)
            variance = column @ other.covariance @ column
            found.append(0.5 * miss**2 / (1.0 + variance))
        return np.array(found)

    def _predict(self, inputs: SequenceInputs) -> PredictedRuns:
        shown, moves = [], []
        for item in self.models:
            plain = self.around.record(inputs, self.start_c)
            free = free_run(item.file.twin(), plain)
            guess = replace(plain, temp=np.concatenate([plain.temp[:, :1], free], axis=1))
            rests = np.ones(len(free), dtype=bool)
            runs = FitRuns(guess, item.error_k, rests, np.full(len(rests), self.around.guessed))
            found = simulate([(item.file, item.free, item.x)], runs)[0]
            own = np.einsum("kj,kbn->jbn", _root(item.covariance), found.slopes)
            # A run has a start, a power and perhaps a room of its own.
            own = np.concatenate([own, found.starts * found.sds.T[:, :, None]])
            shown.append(free)
            moves.append(own)
        return PredictedRuns(np.stack(shown), tuple(moves))

    def _against(
        self,
        other: int,
        trues: Sequence[int],
        predicted: PredictedRuns,
        within: NDArray[np.bool_],
        exact: Place | None,
    ) -> Floats:
        """By how much this model falls behind each of those that may be true, refitted [trues, B]."""
        error_k = self.models[other].error_k
        misses = np.where(within, predicted.shown[trues] - predicted.shown[other], 0.0) / error_k
        moves = np.where(within, predicted.moves[other], 0.0) / error_k
        if exact is not None:
            misses, moves = self._knowing(exact, other, trues, misses, moves)
        return _remainder(misses, moves)

    def _knowing(
        self, place: Place, other: int, trues: Sequence[int], misses: Floats, moves: Floats
    ) -> tuple[Floats, Floats]:
        """With one more row: a calibration's reading of the value, as it truly is."""
        item = self.models[other]
        found = [_calibration(self.models[true], item, place) for true in trues]
        column = _root(item.covariance).T @ found[0][0]
        column = np.pad(column, (0, len(moves) - len(column)))
        runs = misses.shape[1]
        miss = np.broadcast_to(np.array([own for _, own in found])[:, None, None], (len(trues), runs, 1))
        move = np.broadcast_to(column[:, None, None], (len(moves), runs, 1))
        return np.concatenate([misses, miss], axis=2), np.concatenate([moves, move], axis=2)


def separation(rivals: Rivals, around: Surroundings, row_s: float) -> Separation:
    """Return the rivals at the plan's rows."""
    models = tuple(replace(item, file=replace(item.file, sample_s=row_s)) for item in rivals.models)
    return Separation(rivals, models, around, row_s, resting_c(models[0].file.twin(), around))


def _root(covariance: Floats) -> Floats:
    """L with L L' = covariance, which may have directions that are known exactly."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _remainder(misses: Floats, moves: Floats) -> Floats:
    """Half the sum of squares of misses [M, B, N] that moves [K, B, N] of size 1 cannot make up for."""
    whole = np.einsum("mbn,mbn->mb", misses, misses)
    along = np.einsum("kbn,mbn->bkm", moves, misses)
    normal = np.eye(len(moves)) + np.einsum("kbn,jbn->bkj", moves, moves)
    made_up = np.einsum("bkm,bkm->mb", along, np.linalg.solve(normal, along))
    return np.asarray(0.5 * np.maximum(whole - made_up, 0.0))


def _calibration(true: FittedTwin, other: FittedTwin, place: Place) -> tuple[Floats, float]:
    """Return the reading of a calibration under the other model, and its error in standard deviations."""
    i = [item.place for item in true.free].index(place)
    j = [item.place for item in other.free].index(place)
    column = np.zeros(len(other.covariance))
    column[j] = 1.0 / EXACT_SD
    return column, float(true.x[i] - other.x[j]) / EXACT_SD
