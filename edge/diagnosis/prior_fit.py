"""A short run fitted about a prior, and what twins of its kind miss by anyway.

An hour of a box that its twin could follow would tell each value. No twin can: the sun comes and a room
stirs, and what warms unevenly has no place in it. A fit that knows of no such error finds it in a loss or in
a slow mass, and is sure of it. So the reading may drift from what the twin says, by as much as twins of the
kind miss by (Kennedy and O'Hagan 2001, J. Royal Statistical Society B 63: model inadequacy). An hour that is
missed by more than that had something in it that days of other boxes had not, and counts for less.

A box may be odd in one thing, as by a lid that stands open. So what is far from its kind is held to it less
the farther it is, by tails of Student's t (West 1984, J. Royal Statistical Society B 46), and the rest of the
box is still its kind's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.fitting import fit
from edge.diagnosis.free_fit import FINELY, fit_values, free_levels, rms_k
from edge.diagnosis.noise_levels import first_levels
from edge.diagnosis.prepare import PreparedRuns
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, SizedTerm
from edge.diagnosis.unknowns import UnknownValue, unknowns
from edge.twin.effects.effect import ParameterKind
from edge.twin.effects.library import EFFECTS
from edge.twin.provenance import LOSS_SHARE, LOSS_TAKEN, PRIOR, USUAL_MISS, provenance_numbers
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
MOST_LOSS = 2.0  # times, to either side: a fleet that says more is wrong
FAR_SPREADS = 3.0  # one value in 370 of those that are spread like their kind's
# These, DOUBT and TAILS were found on development boxes (docs/measured/fleet.md).
USUAL_MISS_K = 0.3  # where the fleet does not tell what twins of the kind miss by
DRIFT_TAU_S = 600.0  # over which errors go together
DRIFT_SHARE = 0.95  # of the drift's variance that its terms hold
MOST_POINTS, MOST_TERMS = 360, 30  # of a run: more cost time in tests of a day and tell nothing
DOUBT = 2.0  # power of what an hour is missed by, in usual misses, by which it counts less
TAILS, ROUNDS = 3.0, 5  # degrees of freedom of a value's prior; fits in which its spread settles


def usual_miss_k(file: TwinFile) -> float:
    """Return what twins of its kind usually miss by; USUAL_MISS_K where no fleet has told [K]."""
    return max(provenance_numbers(file, PRIOR, USUAL_MISS), default=0.0) or USUAL_MISS_K


def as_over_days(file: TwinFile) -> TwinFile:
    """Return a twin that an hour told with the loss that its kind has over days, where the fleet has told it.

    What was taken is kept beside, so that it is not taken twice.
    """
    told = provenance_numbers(file, PRIOR, LOSS_SHARE)
    if not told:
        return file
    share = min(max(*told, 1.0 / MOST_LOSS), MOST_LOSS)
    prior = {key: item for key, item in file.provenance[PRIOR].items() if key != LOSS_SHARE}
    return replace(
        with_loss(file, share), provenance={**file.provenance, PRIOR: {**prior, LOSS_TAKEN: share}}
    )


def with_loss(file: TwinFile, share: float) -> TwinFile:
    """Return a twin that loses so many times its heat to the room."""
    known = file.values()

    def times(value: Value) -> Value:
        low, high = (None if edge is None else share * edge for edge in (value.low, value.high))
        return replace(value, value=share * value.value, low=low, high=high)

    return file.with_values({place: times(known[place]) for place in known if _is_loss(place)})


def _is_loss(place: Place) -> bool:
    part, *names = place
    return part == "effects" and EFFECTS[names[0]].parameter(names[1]).kind is ParameterKind.ROOM_LOSS


def far_values(start: TwinFile, twin: TwinFile) -> Iterator[str]:
    """Say which values of a fitted twin are far from those of its kind.

    start : what a fleet made of the description
    """
    values, fitted = start.values(), twin.values()
    for item in unknowns(start):
        usual = values[item.place]
        if usual.rel_sd is None or usual.value == 0.0 or item.place not in fitted:
            continue
        own = fitted[item.place].value
        spreads = (item.coordinate(own) - item.mean) / item.sd
        if abs(spreads) > FAR_SPREADS:
            far = f"{own / usual.value:.2g} times that of its kind ({spreads:+.1f} spreads)"
            yield f"{'.'.join(item.place[1:])} is {far}: is the kind right?"


def fit_about(prepared: PreparedRuns, miss_k: float, near: FittedTwin | None = None) -> FittedTwin:
    """Return the twin with its uncertain values at their best.

    miss_k : of free runs by twins of its kind, RMS; near : the same twin, fitted to a part of the runs
    Errors : DataError for a twin that the runs can't be fitted to
    """
    file, runs = prepared.file, prepared.runs
    rooms = tuple(term for term in prepared.terms if term.of_room)
    terms = (*rooms, *drifts(runs.duty.shape, file.sample_s, miss_k))
    noise_k = first_levels(file, runs).sensor_k
    (found,) = fit_values([file], terms, runs, noise_k, SideBySide(), [near])
    usual, usual_k = found.free, float(np.hypot(miss_k, noise_k))
    found = _fit_with_tails(found, usual, runs)
    beyond = rms_k(found, runs) / usual_k
    return found if beyond <= 1.0 else _fit_with_doubt(found, usual, file, runs, beyond)


def _fit_with_tails(found: FittedTwin, usual: Sequence[UnknownValue], runs: RunBatch) -> FittedTwin:
    """Return a fit by priors of Student's t in place of the usual ones, by iteratively reweighted spreads."""
    for _ in range(ROUNDS):
        away = [(x - item.mean) / item.sd for x, item in zip(found.coordinates, usual, strict=True)]
        free = tuple(
            replace(item, sd=item.sd * float(np.sqrt((TAILS + z**2) / (TAILS + 1.0))))
            for z, item in zip(away, usual, strict=True)
        )
        (found,) = fit([replace(found.trial, file=found.file, free=free)], runs, FINELY)
    return found


def _fit_with_doubt(
    found: FittedTwin, usual: tuple[UnknownValue, ...], file: TwinFile, runs: RunBatch, beyond: float
) -> FittedTwin:
    """Return a fit to runs that count less, as its free run misses them by more than is usual.

    file : what it was fitted from; beyond : the miss in usual misses
    """
    levels = free_levels(found.trial.levels.sensor_k * beyond**DOUBT)
    begins = [replace(found.trial, file=one, free=usual, levels=levels) for one in (found.file, file)]
    best = max(fit(begins, runs, FINELY), key=lambda one: one.log_likelihood)
    return _fit_with_tails(best, usual, runs)


def drifts(shape: tuple[int, int], step_s: float, miss_k: float) -> tuple[SizedTerm, ...]:
    """Return the drift of each run's reading as a few terms: those of its covariance that are largest.

    A first-order process over DRIFT_TAU_S, by its Karhunen-Loeve expansion. shape : [B, N] of the runs
    """
    count, rows = shape
    times_s = step_s * np.arange(rows)
    points_s = np.linspace(0.0, times_s[-1], min(rows, MOST_POINTS))
    covariance = miss_k**2 * np.exp(-np.abs(points_s[:, None] - points_s) / DRIFT_TAU_S)
    variances, shapes = np.linalg.eigh(covariance)
    variances, shapes = variances[::-1], shapes[:, ::-1]
    terms = 1 + int(np.searchsorted(np.cumsum(variances), DRIFT_SHARE * variances.sum()))
    largest = zip(variances[: min(terms, MOST_TERMS)], shapes.T, strict=False)
    sized = [np.interp(times_s, points_s, np.sqrt(variance) * own) for variance, own in largest]
    return tuple(
        SizedTerm(f"drift {i} of run {run}", np.outer(drift, own), 1.0, of_reading=True)
        for run, own in enumerate(np.eye(count), 1)
        for i, drift in enumerate(sized, 1)
    )
