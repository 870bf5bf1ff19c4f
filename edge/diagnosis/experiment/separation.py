"""How well an experiment would tell rivals apart: expected log odds of the true one over each other.

The true twin's temperatures less the other's, whitened by the other's filter, less what the other makes up
for by moving its free values as far as the runs so far let it: half the sum of squares that is left is by how
much its likelihood falls behind (a T-optimal design, Atkinson & Fedorov 1975, Biometrika 62, with the runs so
far as prior; linear in the values, about where they were fitted).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.rivals import Rivals
from edge.diagnosis.experiment.sequence import SequenceInputs
from edge.diagnosis.experiment.surroundings import Surroundings, free_run, resting_c
from edge.diagnosis.fitting import slopes
from edge.diagnosis.formulas import PREFIX, formulas
from edge.diagnosis.innovations import FilterInput, gains, whiten
from edge.diagnosis.nuisances import ROOM_SD_K, curved_loss
from edge.diagnosis.trial import FittedTwin, SizedTerm
from edge.twin.linearise import LinearSteps, linearise, responses
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place
from edge.twin.warm_start import spread

Floats = NDArray[np.float64]
EXACT_SD = 0.005  # of a calibrated value, in its coordinate: half a percent


@dataclass(frozen=True, slots=True, eq=False)
class PredictedRuns:
    """Temperatures and step matrices that each model predicts for the experiments.

    shown : [M, B, N] [°C]
    """

    shown: Floats
    runs: tuple[RunBatch, ...]
    steps: tuple[LinearSteps, ...]
    terms: tuple[tuple[SizedTerm, ...], ...]


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
        shown, runs, steps, terms = [], [], [], []
        for item in self.models:
            twin, plain = item.file.twin(), self.around.record(inputs, self.start_c)
            free = free_run(twin, plain)
            guess = replace(plain, temp=np.concatenate([plain.temp[:, :1], free], axis=1))
            own = linearise(twin, guess)
            again = _again(item, guess, self.row_s)
            shown.append(free + np.einsum("q,qbn->bn", item.sizes, _effects(again, own, free.shape)))
            runs.append(guess)
            steps.append(own)
            terms.append(again)
        return PredictedRuns(np.stack(shown), tuple(runs), tuple(steps), tuple(terms))

    def _against(
        self,
        other: int,
        trues: Sequence[int],
        predicted: PredictedRuns,
        within: NDArray[np.bool_],
        exact: Place | None,
    ) -> Floats:
        """By how much this model falls behind each of those that may be true, refitted [trues, B]."""
        item, steps = self.models[other], predicted.steps[other]
        moves = np.array([term.shape.T for term in slopes(item, predicted.runs[other])])  # perhaps none
        effects = _effects(predicted.terms[other], steps, within.shape)
        moves = np.concatenate([moves.reshape(-1, *within.shape), effects])
        root = _root(item.covariance)
        if self.around.guessed:  # a run has a room of its own
            moves, root = _with_room(moves, root, steps, within.shape)
        misses = predicted.shown[trues] - predicted.shown[other]
        twin = item.file.twin()
        filters = gains([FilterInput(steps, item.trial.levels, spread(twin), self.row_s)], within)
        columns = np.concatenate([misses, moves])
        white = whiten(filters, np.zeros(len(columns), dtype=np.intp), columns)
        misses, moves = white[: len(trues)], np.einsum("kj,kbn->jbn", root, white[len(trues) :])
        if exact is not None:
            misses, moves = self._knowing(exact, other, trues, misses, moves, root)
        return _remainder(misses, moves)

    def _knowing(
        self, place: Place, other: int, trues: Sequence[int], misses: Floats, moves: Floats, root: Floats
    ) -> tuple[Floats, Floats]:
        """With one more row: a calibration's reading of the value, as it truly is."""
        item = self.models[other]
        found = [_calibration(self.models[true], item, place) for true in trues]
        column = np.pad(found[0][0], (0, len(root) - len(found[0][0])))
        runs = misses.shape[1]
        miss = np.broadcast_to(np.array([own for _, own in found])[:, None, None], (len(trues), runs, 1))
        move = np.broadcast_to((root.T @ column)[:, None, None], (len(moves), runs, 1))
        return np.concatenate([misses, miss], axis=2), np.concatenate([moves, move], axis=2)


def separation(rivals: Rivals, around: Surroundings, row_s: float) -> Separation:
    """Return the rivals at the plan's rows."""
    models = tuple(_at_rows(item, row_s) for item in rivals.models)
    return Separation(rivals, models, around, row_s, resting_c(models[0].file.twin(), around))


def _at_rows(item: FittedTwin, row_s: float) -> FittedTwin:
    """Return the same model with steps as long as a row."""
    return replace(
        item,
        file=replace(item.file, sample_s=row_s),
        trial=replace(item.trial, file=replace(item.trial.file, sample_s=row_s)),
    )


def _again(item: FittedTwin, runs: RunBatch, row_s: float) -> tuple[SizedTerm, ...]:
    """Return a model's nuisances over other runs. Nuisances that belong to a past run have no effect."""
    names = [term.name for term in item.trial.nuisances]
    shapes = {"curved loss": curved_loss(runs, runs.temp, 1.0).shape}
    if any(name.startswith(PREFIX) for name in names):
        shapes |= {name: term.shape for name, (_, term) in formulas(runs, runs.temp, row_s).items()}
    still = np.zeros(runs.fan.T.shape)
    return tuple(replace(term, shape=shapes.get(term.name, still)) for term in item.trial.nuisances)


def _effects(terms: Sequence[SizedTerm], steps: LinearSteps, shape: tuple[int, ...]) -> Floats:
    """Return the effect on the temperature of each term at a size of 1, [q, B, N]."""
    if not terms:
        return np.zeros((0, *shape))
    shown = responses([term.response(steps) for term in terms])
    for i, term in enumerate(terms):
        if term.of_reading:
            shown[i] = term.shape.T
    return shown


def _with_room(
    moves: Floats, root: Floats, steps: LinearSteps, shape: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """With one more value that is free: the room's temperature, of which nothing was recorded."""
    room = SizedTerm("room", np.ones(shape[::-1]), ROOM_SD_K, of_room=True)
    size = len(root)
    wider = np.pad(root, ((0, 1), (0, 1)))
    wider[size, size] = ROOM_SD_K
    return np.concatenate([moves, _effects([room], steps, shape)]), wider


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
    return column, float(true.coordinates[i] - other.coordinates[j]) / EXACT_SD
