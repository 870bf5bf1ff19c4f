"""Twins by separable least squares over free runs, many side by side.

Only what a twin file leaves open is searched. How each run begins, and its room where nobody measured it,
follow from the rows that a fit sees by linear least squares with weak priors (variable projection, Golub &
Pereyra 1973, SIAM J. Numer. Anal. 10).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.unknowns import UnknownValue, path_priors, place_unknowns, unknowns
from edge.twin.linearise import EnsembleRun, LinearSteps, linearise, responses
from edge.twin.model import BoxTwin
from edge.twin.network import AIR, HEATER, SENSOR
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
DIFFERENCE = 1e-3  # of a coordinate, for a derivative
LARGEST_MOVE = 1.0  # of a coordinate in one iteration
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-6, 1e6
ARRIVED = 1e-4  # of the cost, that an iteration gains no more than
START_SD_K, REST_SD_K, BODY_SD_K, ROOM_SD_K = 0.5, 1.0, 10.0, 10.0
FIRST_POWER = 0.3  # of the heater's power that its element may hold at first
POWER_SD, HEAT_SD = 0.01, 0.01  # of a run's power, and of a heat through all of it: shares of the heater's
NEVER_SD = 1e-6  # of what a run of its own must not tell
RUNAWAY_K = 1e4
MOST_NUMBERS, STARTS = 1e6, 8  # of responses at once; about so many are to a twin's starts
LONGEST_SHARE = 0.1  # of a run, over which errors are taken to go together


@dataclass(frozen=True, slots=True, eq=False)
class FitRuns:
    """Rows that twins are fitted to.

    batch : its room an assumed constant in runs where nobody measured it; noise_k : of a reading
    rests, open_rooms : [B], runs that begin in balance with their rooms, and those with an assumed room
    power_sd, heat_sd : of a run's power, and of a heat through all of it, as shares of the heater's
    """

    batch: RunBatch
    noise_k: float
    rests: Mask
    open_rooms: Mask
    power_sd: float = POWER_SD
    heat_sd: float = HEAT_SD

    @property
    def room_is_open(self) -> bool:
        """True if the room of a run is to be found."""
        return bool(self.open_rooms.any())

    @property
    def seen(self) -> Mask:
        """Rows behind which a temperature was measured, [B, N]."""
        return np.isfinite(self.batch.temp[:, 1:])

    @property
    def first_c(self) -> Floats:
        """First readings of the runs, [B] [°C]."""
        return np.array([temp[np.isfinite(temp)][0] for temp in self.batch.temp])


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """A twin over all runs, and what it would show if anything were otherwise.

    error : [B, N] measured minus shown, begun at the starts expected, 0 where not measured
    slopes : [p, B, N] of what is shown, by coordinate; starts : [S, B, N], by start, the room last if open
    expected, sds : [B, S] of the starts; shifted : [B, n] K of the states by 1 K of the room if open
    """

    error: Floats
    slopes: Floats
    starts: Floats
    expected: Floats
    sds: Floats
    shifted: Floats

    def left(self, moved: Floats) -> Floats:
        """Return the errors of runs whose starts are so far from those expected, [B, N]. moved : [B, S]"""
        return np.asarray(self.error - np.einsum("sbn,bs->bn", self.starts, moved))

    def starts_at(self, moved: Floats) -> Floats:
        """Return the starts that are so far from those expected, [B, S]."""
        found = self.expected + moved
        found[:, : self.shifted.shape[1]] += self.shifted * moved[:, -1:]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class FittedTwin:
    """A twin at its best.

    file : with the values found; errors : [B, N] of free runs over seen rows, NaN elsewhere [K]
    starts : [B, S], each run's first states, its power's and its heat's share off the usual, its room if open
    covariance : [p, p], of the coordinates
    """

    file: TwinFile
    free: tuple[UnknownValue, ...]
    x: Floats
    cost: float
    error_k: float
    errors: Floats
    starts: Floats
    covariance: Floats
    simulated: Simulated

    @property
    def rmse_k(self) -> float:
        """Error of free runs over what was seen [K]."""
        return float(np.sqrt(np.nanmean(self.errors**2)))


@dataclass(slots=True, eq=False)
class _Task:
    file: TwinFile
    free: tuple[UnknownValue, ...]
    x: Floats
    mask: Mask
    iterations: int
    damping: float = FIRST_DAMPING
    error_k: float = 0.0
    cost: float = np.inf
    here: Simulated | None = None
    best: Floats = field(default_factory=lambda: np.empty(0))
    slopes: Floats | None = None  # that are kept from where it began
    exact: bool = False  # whether the slopes at the best place are computed there, not followed from others
    refresh: bool = True  # whether they are wanted next
    done: bool = False


def simulate(
    tasks: Sequence[tuple[TwinFile, Sequence[UnknownValue], Floats]], runs: FitRuns, slopes: bool = True
) -> list[Simulated]:
    """Run twins at coordinates. slopes : whether those are wanted, which take most of the time"""
    each = max((len(free) if slopes else 0) for _, free, _ in tasks) + STARTS
    at_once = max(1, int(MOST_NUMBERS / (each * runs.seen.size)))
    if len(tasks) > at_once:  # a small machine lacks the memory for all
        some = (tasks[i : i + at_once] for i in range(0, len(tasks), at_once))
        return [found for part in some for found in simulate(part, runs, slopes)]
    batch, wanted, parts = runs.batch, list[EnsembleRun](), list[tuple[Floats, Floats, Floats, Floats]]()
    first_c, room_c = runs.first_c, batch.ambient[:, 0]
    for file, free, x in tasks:
        twin, steps = _at(file, free, x, batch)
        expected = at_rest(twin, first_c, room_c)
        moves = np.empty(len(free) if slopes else 0)
        wanted.append(EnsembleRun(steps, expected, steps.driven))
        for j, item in enumerate(free[: len(moves)]):
            near = x.copy()
            moves[j] = DIFFERENCE if x[j] + DIFFERENCE <= item.bounds[1] else -DIFFERENCE
            near[j] += moves[j]
            other, moved = _at(file, free, near, batch)
            wanted.append(EnsembleRun(moved, at_rest(other, first_c, room_c), moved.driven))
        size = len(twin.states)
        wanted += [EnsembleRun(steps, np.tile(row, (len(first_c), 1)), None) for row in np.eye(size)]
        # Mains and draughts: a run's power and heat are not quite those of another.
        wanted.append(EnsembleRun(steps, None, steps.duty))
        wanted.append(EnsembleRun(steps, None, steps.heat * twin.geometry.heater_max_w))
        warmer = np.zeros_like(expected)
        if runs.room_is_open:
            # A warmer room also means that a run begun at rest began elsewhere.
            warmer = at_rest(twin, first_c, room_c + 1.0) - expected
            wanted.append(EnsembleRun(steps, warmer, steps.room))
        parts.append((moves, expected, _spread(twin, expected, runs), warmer))
    shown = responses(wanted)
    seen, measured = runs.seen, np.nan_to_num(batch.temp[:, 1:])
    found, at = [], 0
    for moves, expected, sds, warmer in parts:
        p, s = len(moves), sds.shape[1]
        nominal = shown[at]
        steepness = (shown[at + 1 : at + 1 + p] - nominal) / moves[:, None, None]
        starts = shown[at + 1 + p : at + 1 + p + s]
        at += 1 + p + s
        error = np.where(seen, _clip(measured - nominal), 0.0)
        whole = np.column_stack([expected, np.zeros((len(room_c), 2)), room_c])[:, :s]
        found.append(Simulated(error, _clip(steepness), _clip(starts), whole, sds, warmer))
    return found


def _clip(values: Floats) -> Floats:
    return np.clip(np.nan_to_num(values, nan=RUNAWAY_K), -RUNAWAY_K, RUNAWAY_K)


def _at(
    file: TwinFile, free: Sequence[UnknownValue], x: Floats, batch: RunBatch
) -> tuple[BoxTwin, LinearSteps]:
    twin = place_unknowns(file, free, x).twin()
    return twin, linearise(twin, batch)


def _spread(twin: BoxTwin, expected: Floats, runs: FitRuns) -> Floats:
    """How far (sd) the states may be from rest, and the room if open, [B, S]."""
    count = len(expected)
    body = np.where(runs.rests, REST_SD_K, BODY_SD_K)
    power_w = np.full(count, FIRST_POWER * twin.geometry.heater_max_w)
    table = {AIR: np.full(count, START_SD_K), SENSOR: np.full(count, START_SD_K), HEATER: power_w}
    found = [table.get(name, body) for name in twin.states]
    found += [np.full(count, runs.power_sd), np.full(count, runs.heat_sd)]
    if runs.room_is_open:
        sd = np.where(runs.rests, REST_SD_K, ROOM_SD_K)
        found.append(np.where(runs.open_rooms, sd, NEVER_SD))
    return np.column_stack(found)


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """Sums over rows, the starts at their best: square, gradient and normal matrix, and how to get starts."""

    square: float
    gradient: Floats
    normal: Floats
    solve_error: Floats  # [B, S], starts that explain the error
    solve_slopes: Floats  # [B, S, p]


def project(found: Simulated, mask: Mask, error_k: float) -> Projected:
    """Add up over masked rows, in (standard deviations of an error)²."""
    a = np.where(mask, found.starts, 0.0).swapaxes(0, 1) / error_k
    every = np.where(mask, np.concatenate([found.error[None], found.slopes]), 0.0) / error_k
    gram = a @ a.swapaxes(1, 2)
    scale = np.arange(gram.shape[1])
    gram[:, scale, scale] += found.sds**-2
    told = a @ every.transpose(1, 2, 0)
    size = 1.0 / np.sqrt(gram[:, scale, scale])
    gram *= size[:, :, None] * size[:, None, :]
    own = size[:, :, None] * np.linalg.solve(gram, size[:, :, None] * told)
    flat = every.reshape(len(every), -1)
    sums = flat @ flat.T - np.einsum("bsp,bsq->pq", told, own)
    square, gradient, normal = float(sums[0, 0]), sums[0, 1:], sums[1:, 1:]
    by_error, by_slopes = own[:, :, 0], own[:, :, 1:]
    return Projected(square, gradient, normal, by_error, by_slopes)


def _prior(task: _Task, x: Floats) -> float:
    own = sum(((a - item.mean) / item.sd) ** 2 for a, item in zip(x, task.free, strict=True))
    return float(own + sum(item**2 for item in path_priors(place_unknowns(task.file, task.free, x))))


def _with_priors(task: _Task, sums: Projected) -> tuple[Floats, Floats]:
    """Return gradient and normal matrix, priors counted."""
    normal, gradient = sums.normal.copy(), sums.gradient.copy()
    for j, item in enumerate(task.free):
        normal[j, j] += item.sd**-2
        gradient[j] += (item.mean - task.x[j]) / item.sd**2
    here = path_priors(place_unknowns(task.file, task.free, task.x))
    if here:
        slopes = np.empty((len(here), len(task.free)))
        for j in range(len(task.free)):
            near = task.x.copy()
            near[j] += DIFFERENCE
            there = path_priors(place_unknowns(task.file, task.free, near))
            slopes[:, j] = (np.array(there) - here) / DIFFERENCE
        normal += slopes.T @ slopes
        gradient -= slopes.T @ np.array(here)
    return gradient, normal


def together(errors: Floats, mask: Mask) -> float:
    """How many errors tell what one would if they had nothing in common: at least 1. errors : [B, N]

    Bartlett's weights (Newey & West 1987, Econometrica 55).
    """
    white = np.where(mask, errors, 0.0)
    square = float((white**2).sum())
    if not square > 0.0:
        return 1.0
    lags = max(1, round(LONGEST_SHARE * mask.sum(axis=1).max()))
    size = 2 * white.shape[1]
    spectrum = np.abs(np.fft.rfft(white, size)) ** 2
    correlation = np.fft.irfft(spectrum, size).sum(axis=0)[1 : lags + 1] / square
    weights = 2.0 * (1.0 - np.arange(1, lags + 1) / (lags + 1.0))
    return max(1.0, 1.0 + float(weights @ correlation))


@dataclass(frozen=True, slots=True, eq=False)
class Begun:
    """A twin to be fitted: what may move, with its priors, and from where."""

    file: TwinFile
    free: tuple[UnknownValue, ...]
    x: Floats


def begun(file: TwinFile) -> Begun:
    """Return a file with what it leaves open or uncertain, at its values."""
    free, values = unknowns(file), file.values()
    return Begun(file, free, np.array([item.coordinate(values[item.place].value) for item in free]))


def fit_twins(
    starts: Sequence[Begun | FittedTwin],
    runs: FitRuns,
    iterations: int,
    masks: Sequence[Mask] | None = None,
) -> list[FittedTwin]:
    """Fit twins from where they are.

    masks : [B, N] each, rows that a fit may see, by the slopes of the fit to all; None: all
    """
    tasks = []
    for i, item in enumerate(starts):
        mask = runs.seen if masks is None else runs.seen & masks[i]
        level = item.error_k if isinstance(item, FittedTwin) else 0.0
        task = _Task(item.file, item.free, item.x, mask, iterations, best=item.x, error_k=level)
        tasks.append(task)
        if masks is not None and isinstance(item, FittedTwin):
            task.slopes = item.simulated.slopes
            _take(task, item.simulated, runs.noise_k, last=False)
    for number in range(iterations + 1):
        for task, found in _places([task for task in tasks if not task.done], runs):
            _take(task, found, runs.noise_k, last=number == iterations)
    stale = [task for task in tasks if not task.exact and task.slopes is None]
    for task in stale:
        task.refresh = True
    for task, found in _places(stale, runs):
        task.here = found
    return [_finish(task, runs) for task in tasks]


def _places(tasks: Sequence[_Task], runs: FitRuns) -> Iterator[tuple[_Task, Simulated]]:
    """Yield each task with what its place shows, with slopes."""
    for whole in (True, False):
        now = [task for task in tasks if whole is (task.refresh and task.slopes is None)]
        shown = simulate([(t.file, t.free, t.x) for t in now], runs, whole) if now else []
        for task, found in zip(now, shown, strict=True):
            if task.slopes is not None:
                yield task, replace(found, slopes=task.slopes)
            elif whole:
                yield task, found
            else:
                assert task.here is not None
                yield task, replace(found, slopes=_follow(task.here, found, task.x - task.best))


def _follow(before: Simulated, after: Simulated, move: Floats) -> Floats:
    """Return slopes after a move, by what it did (Broyden 1965, Mathematics of Computation 19)."""
    missed = before.error - after.error - np.einsum("pbn,p->bn", before.slopes, move)
    return np.asarray(before.slopes + move[:, None, None] / max(float(move @ move), 1e-12) * missed)


def _take(task: _Task, found: Simulated, noise_k: float, last: bool) -> None:
    """Go on from where a simulation was, or back."""
    if not task.error_k:
        task.error_k = _level(found, task.mask, noise_k, noise_k)
    sums = project(found, task.mask, task.error_k)
    cost = 0.5 * (sums.square + _prior(task, task.x))
    if task.refresh and task.here is not None and task.slopes is None:
        task.here, task.exact, task.refresh = found, True, False
    elif cost < task.cost:
        gained, known = task.cost - cost, task.exact or task.slopes is not None
        task.cost, task.here, task.best = cost, found, task.x
        task.exact, task.refresh = task.refresh, False
        task.damping = max(task.damping / 10.0, LEAST_DAMPING)
        if gained < ARRIVED * max(cost, 1.0):
            # A step along slopes that are not those of its place is no proof that there is nothing to gain.
            task.done, task.refresh = known, not known
        # What is left tells how far a reading may be off; the costs before are of another measure then.
        level = _level(found, task.mask, noise_k, task.error_k)
        if not task.done and abs(np.log(level / task.error_k)) > 0.1:
            task.error_k = level
            sums = project(found, task.mask, level)
            task.cost = 0.5 * (sums.square + _prior(task, task.x))
    else:
        task.x = task.best
        assert task.here is not None
        sums = project(task.here, task.mask, task.error_k)
        if task.exact or task.slopes is not None:
            task.damping *= 10.0
            task.done = task.damping > MOST_DAMPING
        else:
            task.refresh = True
    if last or task.done or not len(task.x):
        task.x, task.done = task.best, True
        return
    if task.refresh and task.slopes is None:
        return
    gradient, normal = _with_priors(task, sums)
    damped = normal + task.damping * np.diag(np.diag(normal))
    move = np.linalg.lstsq(damped, gradient, rcond=1e-14)[0]
    largest = np.abs(move).max()
    if largest > LARGEST_MOVE:
        move *= LARGEST_MOVE / largest
    limits = np.array([item.bounds for item in task.free])
    task.x = np.clip(task.x + move, limits[:, 0], limits[:, 1])


def _level(found: Simulated, mask: Mask, noise_k: float, before_k: float) -> float:
    """Return what an error may be, errors that go together counted once [K]."""
    sums = project(found, mask, before_k)
    errors = found.left(sums.solve_error)
    count = max(int(mask.sum()), 1)
    error_k = max(noise_k, float(np.sqrt((errors[mask] ** 2).sum() / count)))
    return min(error_k * float(np.sqrt(together(errors, mask))), RUNAWAY_K)


def _finish(task: _Task, runs: FitRuns) -> FittedTwin:
    found = task.here
    assert found is not None
    sums = project(found, task.mask, task.error_k)
    _, normal = _with_priors(task, sums)
    errors = found.left(sums.solve_error)
    errors[np.abs(found.error) >= RUNAWAY_K] = RUNAWAY_K  # no start makes up for that
    return FittedTwin(
        place_unknowns(task.file, task.free, task.best),
        task.free,
        task.best,
        task.cost,
        task.error_k,
        np.where(runs.seen, errors, np.nan),
        found.starts_at(sums.solve_error),
        np.asarray(np.linalg.pinv(normal, hermitian=True)) if len(task.best) else np.empty((0, 0)),
        found,
    )


def best_starts(file: TwinFile, runs: FitRuns, mask: Mask, error_k: float) -> Floats:
    """Return the states with which runs begin, by masked rows, [B, n]; without any, in balance.

    error_k : that a row may be off by
    """
    found = simulate([(file, (), np.empty(0))], replace(runs, power_sd=NEVER_SD, heat_sd=NEVER_SD))[0]
    sums = project(found, mask & runs.seen, error_k)
    return found.starts_at(sums.solve_error)[:, : len(file.twin().states)]


def left_out_errors(
    fits: Sequence[FittedTwin], folds: Sequence[tuple[Mask, Mask]], runs: FitRuns, again: int
) -> list[Floats]:
    """Return errors over rows that a fit did not see, [B, N] each, NaN in no fold.

    folds : rows that are fitted and rows that are judged; again : iterations of each fit from where it was,
    0 for one step along its slopes
    """
    found = [np.full(runs.seen.shape, np.nan) for _ in fits]
    if again:
        starts = [item for item in fits for _ in folds]
        fitted = fit_twins(starts, runs, again, [mask for _ in fits for mask, _ in folds])
        for i, own in enumerate(found):
            for k, (_, judged) in enumerate(folds):
                rows = judged & runs.seen
                own[rows] = fitted[i * len(folds) + k].errors[rows]
        return found
    for own, item in zip(found, fits, strict=True):
        for mask, judged in folds:
            rows = judged & runs.seen
            own[rows] = _along(item, mask & runs.seen)[0][rows]
    return found


def with_slopes(
    item: FittedTwin, more: Floats, folds: Sequence[tuple[Mask, Mask]], runs: FitRuns
) -> tuple[Floats, Floats]:
    """Return errors over left-out rows with further terms of unknown size, and the sizes over all rows.

    more : [q, B, N], what is shown for a size of 1
    """
    found = replace(item.simulated, slopes=np.concatenate([item.simulated.slopes, more]))
    wider = replace(item, simulated=found)
    errors = np.full(runs.seen.shape, np.nan)
    for mask, judged in folds:
        rows = judged & runs.seen
        errors[rows] = _along(wider, mask & runs.seen)[0][rows]
    return errors, _along(wider, runs.seen)[1][len(item.x) :]


def _along(item: FittedTwin, mask: Mask) -> tuple[Floats, Floats]:
    """Return the errors of a fit to masked rows, by one step along the slopes, and that step."""
    found = item.simulated
    p, q = len(item.x), len(found.slopes)
    sums = project(found, mask, item.error_k)
    move = np.zeros(q)
    if q:
        gradient, normal = sums.gradient.copy(), sums.normal.copy()
        task = _Task(item.file, item.free, item.x, mask, 0)
        own = replace(sums, gradient=gradient[:p], normal=normal[:p, :p])
        gradient[:p], normal[:p, :p] = _with_priors(task, own)
        move = np.asarray(np.linalg.lstsq(normal, gradient, rcond=1e-14)[0], dtype=np.float64)
        move[:p] = np.clip(move[:p], -LARGEST_MOVE, LARGEST_MOVE)
    starts = sums.solve_error - sums.solve_slopes @ move
    return found.left(starts) - np.einsum("pbn,p->bn", found.slopes, move), move
