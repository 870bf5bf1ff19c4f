"""Values that predict: what a twin leaves open, by least squares over free runs, from several starts.

The filter of `edge.diagnosis.innovations` without any unknown heat: what it calls innovations are then
the errors of a free run from the start that suits best, and no coloured noise takes up what values explain.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice, zip_longest

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.fitting import fit
from edge.diagnosis.innovations import NoiseLevels, whiten
from edge.diagnosis.linearisation import TrialState, filters_of, nominal
from edge.diagnosis.nuisances import answer_s
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial, start_of
from edge.diagnosis.unknowns import UnknownValue, place_unknowns, unknowns, with_effect
from edge.twin.effects.effect import Offer, ParameterKind
from edge.twin.effects.library import EFFECTS, parameter_at
from edge.twin.linearise import EnsembleRun, responses
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
FOLDS = 5
BLOCKS = 20  # of all runs together
FIRST_ROWS = 10  # of a run, that are always seen: a forecast begins there


def folds(runs: RunBatch, count: int = FOLDS) -> list[Mask]:
    """Return the measured rows in `count` parts, [B, N] each. A part is
    contiguous in every run; the last part is the end.
    """
    numbers = parts(runs, count)
    return [numbers == i for i in range(count)]


def parts(runs: RunBatch, count: int) -> Indices:
    """Which part of its run each row is in, [B, N]; -1 where nothing was measured or the run begins."""
    known = np.isfinite(runs.temp[:, 1:])
    known[:, :FIRST_ROWS] = False
    place, rows = np.cumsum(known, axis=1) - 1, known.sum(axis=1, keepdims=True)
    return np.where(known, place * count // np.maximum(rows, 1), -1)


def halves(runs: RunBatch) -> Indices:
    """Which half of all that was measured each row is in, runs in the order given, [B, N]; -1 elsewhere."""
    known = np.isfinite(runs.temp[:, 1:])
    place = np.cumsum(known.ravel()).reshape(known.shape) - 1
    return np.where(known, place * 2 // max(int(known.sum()), 1), -1)


def block_sums(values: NDArray[np.float64], runs: RunBatch) -> NDArray[np.float64]:
    """Return sums over blocks of time. values : [B, N]; a value that is not finite counts as 0"""
    each = max(1, round(BLOCKS / len(runs.temp)))
    numbers = parts(runs, each) + each * np.arange(len(runs.temp))[:, None]
    chosen = parts(runs, 1) >= 0
    return np.asarray(
        np.bincount(numbers[chosen], np.nan_to_num(values[chosen]), minlength=each * len(runs.temp)),
        dtype=np.float64,
    )


Floats = NDArray[np.float64]
TAU_S = 600.0  # of a heat that is 0
DRAWN = 8  # starts beside the one that the caller has
FARTHEST = 2.0  # of a start from the usual value, in coordinates
LEAST_K = 1e-3  # of a box that stands still, which is told exactly
HOPELESS_K, RUNAWAY_K = 1e3, 1e6  # nothing that is recorded is so far off; of a twin that runs away
ROUGH_K = 1.0  # what a free run may miss by while starts are tried
ROUGHLY, FINELY = 3, 12  # iterations
LONGEST_LAG_S = 1800.0  # over which errors go together, in the paper's box
KEPT = 2  # starts that are followed to their ends
AS_GOOD = 1.01  # times the error, for other values to be a rival
APART_SDS, NEVER_APART = 4.0, 0.2  # between two values: more is no chance; of a coordinate, that is the same


def free_levels(error_k: float) -> NoiseLevels:
    """No noise but that of what is read: how far a free run may be off [K]."""
    return NoiseLevels(
        sensor_k=max(error_k, LEAST_K), room_k=0.0, heat_w=0.0, heat_tau_s=TAU_S, power_share=0.0
    )


def fit_values(
    files: Sequence[TwinFile],
    terms: Sequence[SizedTerm],
    runs: RunBatch,
    noise_k: float,
    shared: SideBySide,
    near: Sequence[FittedTwin | None] = (),
) -> list[FittedTwin]:
    """Each file's open values at their best, in the order given.

    terms : of unknown size beside them, such as the room's temperature; noise_k : of a reading
    near : for each file a twin that is fitted already and has most of its effects, None where none is
    """
    if not files:
        return []
    every = [_starts(file, tuple(terms), donor) for file, donor in zip_longest(files, near[: len(files)])]
    rough = iter(shared.map(partial(fit, runs=runs, iterations=ROUGHLY), list(chain(*every))))
    lots = [list(islice(rough, len(starts))) for starts in every]
    followed = [_follow(item, noise_k, runs) for lot in lots for item in _best(lot, KEPT)]
    fine = shared.map(partial(fit, runs=runs, iterations=FINELY), followed)
    ends = [_best(fine[i * KEPT : (i + 1) * KEPT], 1)[0] for i in range(len(files))]
    misses = [rms_k(item, runs) for item in ends]
    donor = ends[int(np.argmin(misses))]
    # With the values of the twin that fits best: a way out of a valley.
    moved = [_moved_to(item, _lend(item.free, item.coordinates, donor)) for item in ends]
    lent = [_follow(item, noise_k, runs) for item in moved]
    others = shared.map(partial(fit, runs=runs, iterations=FINELY), lent)
    kept = [
        other if rms_k(other, runs) < miss else item
        for item, other, miss in zip(ends, others, misses, strict=True)
    ]
    last = [_follow(item, noise_k, runs) for item in kept]
    return shared.map(partial(fit, runs=runs, iterations=FINELY), last)


def another(found: FittedTwin, runs: RunBatch, noise_k: float, shared: SideBySide) -> FittedTwin | None:
    """Return a second fit of the same twin that is as good with clearly other
    values, None if other starts find none.
    """
    free, levels = found.free, free_levels(ROUGH_K)
    starts = [
        replace(found.trial, file=place_unknowns(found.file, free, x), free=free, levels=levels)
        for x in (*_exchanges(found), *_draw(free, DRAWN))
    ]
    rough = shared.map(partial(fit, runs=runs, iterations=ROUGHLY), starts)
    far = sorted((item for item in rough if apart(found, item)), key=lambda item: rms_k(item, runs))
    followed = [_follow(item, noise_k, runs) for item in far[:KEPT]]
    ends = shared.map(partial(fit, runs=runs, iterations=FINELY), followed)
    most_k = AS_GOOD * rms_k(found, runs)
    rivals = [item for item in ends if apart(found, item) and rms_k(item, runs) <= most_k]
    return min(rivals, key=lambda item: rms_k(item, runs), default=None)


def _exchanges(found: FittedTwin) -> Iterator[Floats]:
    """Yield coordinates at which a lag and the air have changed places: a slow and a fast answer in a row."""
    values = found.file.values()
    for i, item in enumerate(found.free):
        if not _has_kind(ParameterKind.AIR_LAG, item):
            continue
        without = {name: own for name, own in found.file.effects.items() if name != item.place[1]}
        if (air_s := answer_s(replace(found.file, effects=without).twin())) is None:
            continue
        places = found.coordinates.copy()
        places[i] = item.coordinate(air_s)
        for j, other in enumerate(found.free):
            if _has_kind(ParameterKind.AIR_CAPACITIES, other):
                places[j] = other.coordinate(values[other.place].value * values[item.place].value / air_s)
        yield places


def _has_kind(kind: ParameterKind, item: UnknownValue) -> bool:
    parameter = parameter_at(item.place)
    return parameter is not None and parameter.kind is kind


def apart(found: FittedTwin, other: FittedTwin) -> list[UnknownValue]:
    """Values that two fits of one twin do not agree on."""
    count = len(found.free)
    sds = [np.sqrt(np.maximum(np.diag(item.covariance)[:count], 0.0)) for item in (found, other)]
    off = np.abs(found.coordinates - other.coordinates)
    far = off > np.maximum(APART_SDS * np.hypot(*sds), NEVER_APART)
    return [item for item, is_far in zip(found.free, far, strict=True) if is_far]


def together(innovations: Floats, seen: NDArray[np.bool_], file: TwinFile) -> float:
    """How many errors tell what one would, if they had nothing in common: at least 1.

    innovations : [B, N], in standard deviations; seen : [B, N], where there is one
    Bartlett's weights over LONGEST_LAG_S (Newey & West 1987, Econometrica 55).
    """
    white = np.where(seen, innovations, 0.0)
    square = float((white**2).sum())
    if not square > 0.0:
        return 1.0
    lags = min(max(1, round(LONGEST_LAG_S * file.scale.time / file.sample_s)), white.shape[1] // 4)
    total = 1.0
    for lag in range(1, lags + 1):
        weight = 2.0 * (1.0 - lag / (lags + 1.0))
        total += weight * float((white[:, lag:] * white[:, :-lag]).sum()) / square
    return max(1.0, total) * max(1.0, square / float(seen.sum()))


def _starts(file: TwinFile, terms: tuple[SizedTerm, ...], near: FittedTwin | None) -> list[Trial]:
    """From the file's own values; and from anywhere, or where a twin is near, from there."""
    free, levels = unknowns(file), free_levels(ROUGH_K)
    if near is None:
        places = _draw(free, DRAWN)
    else:
        places = [_lend(free, _here(free, each), near) for each in _begin(file, free, near)]
    return [
        Trial(each, levels, terms, free) for each in (file, *(place_unknowns(file, free, x) for x in places))
    ]


def _here(free: Sequence[UnknownValue], file: TwinFile) -> Floats:
    values = file.values()
    return np.array([item.coordinate(values[item.place].value) for item in free])


def _begin(file: TwinFile, free: Sequence[UnknownValue], near: FittedTwin) -> list[TwinFile]:
    """Return the file with each start of the one effect that the near twin lacks."""
    known = {item.place for item in near.free}
    new = {item.place[1] for item in free if item.place not in known and item.place[0] == "effects"}
    if len(new) != 1:
        return [file]
    (name,) = new
    if EFFECTS[name].offer is Offer.NAMELESS:
        return [file]
    without = {key: values for key, values in file.effects.items() if key != name}
    return with_effect(replace(file, effects=without), name)


def _draw(free: Sequence[UnknownValue], count: int) -> list[Floats]:
    """Coordinates to start from, always the same."""
    drawn = np.random.default_rng(len(free)).uniform(-1.0, 1.0, (count, len(free)))
    return [np.array([_start(item, x) for item, x in zip(free, row, strict=True)]) for row in drawn]


def _start(item: UnknownValue, drawn: float) -> float:
    low, high = item.bounds
    return float(np.clip(item.mean + drawn * min(item.sd, FARTHEST), low, high))


def _lend(free: Sequence[UnknownValue], here: Floats, donor: FittedTwin) -> Floats:
    """Coordinates with those of another twin, where it has them."""
    known = {own.place: float(x) for own, x in zip(donor.free, donor.coordinates, strict=True)}
    return np.array([known.get(own.place, float(x)) for own, x in zip(free, here, strict=True)])


def _moved_to(item: FittedTwin, x: Floats) -> FittedTwin:
    return replace(item, coordinates=x, file=place_unknowns(item.file, item.free, x))


def _best(found: Sequence[FittedTwin], count: int) -> list[FittedTwin]:
    return sorted(found, key=lambda item: -item.log_likelihood)[:count]


def _follow(found: FittedTwin, noise_k: float, runs: RunBatch) -> Trial:
    """From where it is, against what its free runs miss by, errors that go together counted once."""
    errors = free_errors(found, runs, ROUGH_K)
    error_k = min(max(noise_k, float(np.sqrt(np.mean(errors[runs.measured] ** 2)))), HOPELESS_K)
    alike = together(np.clip(errors / error_k, -HOPELESS_K, HOPELESS_K), runs.measured, found.file)
    levels = free_levels(error_k * float(np.sqrt(alike)))
    return replace(found.trial, file=found.file, free=found.free, levels=levels)


def rms_k(found: FittedTwin, runs: RunBatch) -> float:
    """Return the RMS error of free runs over measured rows [K]."""
    return float(np.sqrt(np.mean(free_errors(found, runs, ROUGH_K)[runs.measured] ** 2)))


def free_errors(found: FittedTwin, runs: RunBatch, error_k: float) -> Floats:
    """Measured minus forecast, [B, N], by a free run that knows what `runs` lets it see before each row.

    error_k : what a free run may miss by, against which its start is found
    """
    terms = [term.of_room for term in found.trial.nuisances]  # no other stays with a twin that is handed over
    kept = tuple(term for term in found.trial.nuisances if term.of_room)
    state = TrialState(
        replace(found.trial, levels=free_levels(error_k), nuisances=kept), found.free, found.coordinates
    )
    filters = filters_of([state], runs, runs.measured)
    white = whiten(filters, np.array([0]), _errors(state, found.sizes[terms], runs)[None], everywhere=True)[0]
    errors = white * filters.sd[:, 0].T
    return np.asarray(np.clip(np.nan_to_num(errors, nan=RUNAWAY_K), -RUNAWAY_K, RUNAWAY_K))


def _errors(state: TrialState, sizes: Floats, runs: RunBatch) -> Floats:
    """Return the errors of free runs that begin at rest, [B, N]."""
    twin, steps = nominal(state, state.x, runs)
    wanted = [EnsembleRun(steps, start_of(twin, runs), steps.driven)]
    shown = responses(wanted + [term.response(steps) for term in state.trial.nuisances])
    error = np.nan_to_num(runs.temp[:, 1:]) - shown[0]
    for i, term in enumerate(state.trial.nuisances):
        error = error - sizes[i] * (term.shape.T if term.of_reading else shown[1 + i])
    return np.asarray(error)


def left_out_errors(
    found: Sequence[FittedTwin], folds: Sequence[NDArray[np.bool_]], runs: RunBatch, shared: SideBySide
) -> list[tuple[Floats, Floats]]:
    """Return, for each fit, the free-run errors over rows that it did not see, and how far its values moved.

    folds : [B, N], the rows that are left out, each in one of them
    Returns : errors [B, N], NaN where nothing was read; sds of the coordinates [p] by the grouped jackknife
        (Efron & Tibshirani 1993, An Introduction to the Bootstrap, ch. 11), which hold under misfit
    """
    errors = [np.full(runs.duty.shape, np.nan) for _ in found]
    places: list[list[Floats]] = [[] for _ in found]
    scales = [rms_k(item, runs) for item in found]
    for fold in folds:
        seen = replace(runs, left_out=fold)
        for own, at, item, error_k in zip(errors, places, again(found, seen, shared), scales, strict=True):
            rows = fold & np.isfinite(runs.temp[:, 1:])
            own[rows] = free_errors(item, seen, error_k)[rows]
            at.append(item.coordinates)
    count = len(folds)
    sds = [np.sqrt((count - 1.0) * np.var(np.stack(at), axis=0)) for at in places]
    return list(zip(errors, sds, strict=True))


def widen(found: FittedTwin, sds: Floats) -> FittedTwin:
    """With coordinates as uncertain as they were seen to be. sds : [p]"""
    own = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    by = np.ones(len(own))
    by[: len(sds)] = np.maximum(1.0, sds / own[: len(sds)])
    return replace(found, covariance=found.covariance * np.outer(by, by))


def left_out_nats(
    found: Sequence[FittedTwin], folds: Sequence[NDArray[np.bool_]], runs: RunBatch, shared: SideBySide
) -> list[Floats]:
    """Log likelihood of each reading after those before it, by values that did not see it.

    Returns : [B, N] each, 0 where nothing was left out
    """
    told = [np.zeros(runs.duty.shape) for _ in found]
    for fold in folds:
        for own, item in zip(told, again(found, replace(runs, left_out=fold), shared), strict=True):
            rows = fold & np.isfinite(runs.temp[:, 1:])
            own[rows] = row_nats(item, runs)[rows]
    return told


def again(found: Sequence[FittedTwin], runs: RunBatch, shared: SideBySide) -> list[FittedTwin]:
    """Each fitted anew to other rows, from where it is and with its noise."""
    trials = [replace(item.trial, file=item.file, free=item.free) for item in found]
    return shared.map(partial(fit, runs=runs, iterations=ROUGHLY), trials)


def row_nats(found: FittedTwin, runs: RunBatch) -> Floats:
    """Log likelihood of each reading after those before it, up to a constant, [B, N]; 0 where none is."""
    state = TrialState(found.trial, found.free, found.coordinates)
    filters = filters_of([state], runs, runs.measured)
    white = whiten(filters, np.array([0]), _errors(state, found.sizes, runs)[None])[0]
    return np.where(runs.measured, -0.5 * white**2 - np.log(filters.sd[:, 0].T), 0.0)
