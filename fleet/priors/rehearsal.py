"""A box of the fleet as if it were new: what an hour of it, with what the others tell, foretells of the rest.

Days are in store of boxes that run, so what a start is for can be tried on them. Each in turn is learnt from
an hour of its own, with the prior of the others of its kind, and its twin then runs free over all that was
recorded beside: leave one out. This tells in which structure a kind says most of a new box.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.app.rest_offset import with_rest_offset
from edge.core.errors import DataError
from edge.diagnosis.baselines import bare
from edge.diagnosis.prepare import PreparedRuns, errors_over, prepare
from edge.diagnosis.prior_fit import MOST_LOSS, fit_about, usual_miss_k, with_loss
from edge.diagnosis.runs import PIECE_ROWS, NamedRun, diagnosis_runs, judged_from, measured_rows, pieces
from edge.diagnosis.trial import FittedTwin
from edge.formats.run_file import RecordedRun, cut
from edge.twin.twin_file import TwinFile
from fleet.priors.fleet_prior import LEAST_MISS_K, MOST_MISS_K, BoxSheet, fit_prior

Floats = NDArray[np.float64]
HOUR_S, STRIDE_S = 3600.0, 600.0  # STRIDE_S : from the begin of one hour that is looked at to the next
ROW_S = 10.0  # of step tests; of ticks that are farther apart their own
FULL = 0.5  # of the largest spread of the heater in an hour: the first such, as tests begin at rest
KIND = "kind"
TRIED = 1.1  # times the resistance to the room, beside what was learnt


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """Result of one.

    missed_k : mean error of free runs, geometric over recordings; MOST_MISS_K where its twin runs away
    loss_share : of what it learnt, the loss by which free runs are right in the mean over all of them;
        1 where nothing measures the room, as what that was would be told in its place
    """

    missed_k: float
    loss_share: float = 1.0


def rehearse(box: TwinFile, recorded: Sequence[RecordedRun], others: Sequence[TwinFile]) -> Rehearsal:
    """Return by how much a box is missed, learnt from an hour.

    box : a twin of it, for its description; recorded : in the order of time
    others : twins of its kind in the structure that is tried
    Errors : DataError for recordings without an hour of heat or anything beside it
    """
    hour, rest = an_hour(recorded)
    start = fit_prior([BoxSheet(str(i), KIND, twin) for i, twin in enumerate(others)]).start(bare(box), KIND)
    step_s = max(ROW_S, float(np.median(np.diff(hour.columns["time_s"]))))
    file = with_rest_offset(replace(start, sample_s=step_s), hour)
    runs = diagnosis_runs([("hour", hour)], [(f"rest {i}", run) for i, run in enumerate(rest, 1)], file)
    prepared = prepare(file, runs)
    fitted = fit_about(prepared, usual_miss_k(start))
    missed = _errors(runs.test, fitted, prepared)
    share = 1.0 if prepared.guessed else _loss_share(runs.test, fitted, prepared, _mean_k(missed))
    return Rehearsal(_missed_k(missed), share)


def _errors(tests: Sequence[NamedRun], fitted: FittedTwin, known: PreparedRuns) -> list[Floats]:
    """Return measured minus free run, NaN where not measured, by recording."""
    missed = [errors_over([run], fitted, known) for run in tests]
    return [np.where(np.isnan(own), np.nan, np.clip(own, -MOST_MISS_K, MOST_MISS_K)) for own in missed]


def _missed_k(missed: Sequence[Floats]) -> float:
    """Return the mean error of free runs, geometric over recordings.

    Each counts alike: a day is mostly missed by an offset, its sun, which by rows would hide all else.
    """
    told = [np.abs(errors_k[~np.isnan(errors_k)]) for errors_k in missed]
    means_k = [own.mean() if len(own) else MOST_MISS_K for own in told]
    return float(np.exp(np.log(np.clip(means_k, LEAST_MISS_K, MOST_MISS_K)).mean()))


def _mean_k(missed: Sequence[Floats]) -> float:
    """Return the mean over all recordings by their time, not by readings, which tests have more of."""
    means_k = [0.0 if np.isnan(own).all() else float(np.nanmean(own)) for own in missed]
    return float(np.average(means_k, weights=[len(own) for own in missed]))


def _loss_share(tests: Sequence[NamedRun], fitted: FittedTwin, known: PreparedRuns, mean_k: float) -> float:
    """Return by what the loss is to be multiplied; no further than MOST_LOSS to either side.

    Within an hour walls still take up heat, which a twin without them finds in its loss. A day has some sun.
    What a box is above its room goes with the inverse of its loss, so two free runs tell it.
    mean_k : of the errors with the loss as it is
    """
    other = replace(fitted, file=with_loss(fitted.file, 1.0 / TRIED))
    warmer_k = mean_k - _mean_k(_errors(tests, other, known))
    if not warmer_k > 0.0:
        return 1.0
    wanted = 1.0 + (TRIED - 1.0) * mean_k / warmer_k
    return float(1.0 / np.clip(wanted, 1.0 / MOST_LOSS, MOST_LOSS))


def an_hour(recorded: Sequence[RecordedRun]) -> tuple[RecordedRun, list[RecordedRun]]:
    """Return the hour that is most like step tests, and what was recorded before and after.

    The latter is the run from its begin, with the fact from where on it is judged.

    Errors : DataError for recordings in which no hour has heat, or nothing but it was measured
    """
    parts = [part for run in recorded for part in pieces(run)]
    spreads = [_spreads(part) for part in parts]
    most = max((float(own.max()) for own in spreads if len(own)), default=0.0)
    if not most > 0.0:
        raise DataError(f"{recorded[0].path if recorded else 'nothing'}: no hour in which the heater changes")
    at = next(i for i, own in enumerate(spreads) if len(own) and own.max() >= FULL * most)
    part = parts[at]
    begin_s = STRIDE_S * int(np.argmax(spreads[at] >= FULL * most))
    begin, end = np.searchsorted(part.columns["time_s"], [begin_s, begin_s + HOUR_S]).tolist()
    rest = [*_usable(parts[:at]), *_beside(part, begin, end), *_usable(parts[at + 1 :])]
    if not rest:
        raise DataError(f"{part.path}: nothing was recorded beside one hour")
    return cut(part, begin, end), rest


def _beside(part: RecordedRun, begin: int, end: int) -> list[RecordedRun]:
    """Return what is before an hour, and the whole with what is after it as the part that is judged.

    A run that began after the hour would not know what a slow body had stored by then.
    """
    found = _usable([cut(part, 0, begin)] if begin else [])
    if end < len(part) and _usable([cut(part, end, len(part))]):
        found.append(judged_from(part, end))
    return found


def _usable(runs: Sequence[RecordedRun]) -> list[RecordedRun]:
    return [run for run in runs if measured_rows(run) >= PIECE_ROWS]


def _spreads(run: RecordedRun) -> Floats:
    """Return the standard deviation of the heater's duty in each hour of a run, one every STRIDE_S.

    0 for an hour of which less than half was measured.
    """
    time_s, duty = run.columns["time_s"], np.nan_to_num(run.columns["heater_duty"])
    seen = np.isfinite(run.columns["temp_air_c"])
    begins = np.arange(0.0, time_s[-1] - HOUR_S + 0.5 * STRIDE_S, STRIDE_S)
    rows = np.searchsorted(time_s, [begins, begins + HOUR_S]).T
    return np.array(
        [duty[begin:end].std() if seen[begin:end].sum() > (end - begin) / 2 else 0.0 for begin, end in rows]
    )
