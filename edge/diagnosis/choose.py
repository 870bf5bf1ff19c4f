"""Which grey box a log can tell: grown term by term by the free runs over rows that no fit saw.

From three runs on each fold leaves out whole runs; one or two are forecast from their past, block by block.
A term has to pay in left-out rows. Of those that are not clearly worse than the best there, the simplest
whose fit is about as close as any is taken: short logs tell more by their fit than by a few forecasts.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.fit import BODIES, RATES, GreyBox, Terms, fit, fit_again
from edge.diagnosis.grey_run import GreyRun

Floats = NDArray[np.float64]
WHOLE_RUNS = 3  # from so many on, whole runs are left out
FOLDS = 6
SPLITS = (0.4, 0.55, 0.7, 0.85, 1.0)  # of fewer runs: each part forecast from all before it
BLOCKS = 20  # of all left-out rows
MOST_TERMS = 4
AS_CLOSE = 1.05  # times the least error of a fit
CLEARLY, MATTERS = 1.0, 0.03  # standard errors, and a logarithm: 3 % of an error convince no one of a term


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A structure fitted to all rows. left_out : mean squares of its errors, block by block [K²]"""

    box: GreyBox
    left_out: Floats

    @property
    def left_out_k(self) -> float:
        """RMS error over left-out rows [K]."""
        return float(np.sqrt(np.mean(self.left_out)))

    def behind(self, best: "Tried") -> tuple[float, float]:
        """Return how much more it misses than another, as a logarithm, and the standard error of that."""
        least = best.box.noise_k**2
        more = 0.5 * np.log((self.left_out + least) / (best.left_out + least))
        return float(more.mean()), float(more.std(ddof=1) / np.sqrt(len(more)))


@dataclass(frozen=True, slots=True, eq=False)
class GreyChoice:
    """The grey box that was chosen among those that were tried."""

    terms: Terms
    tried: dict[Terms, Tried]

    @property
    def box(self) -> GreyBox:
        """The box, fitted to all rows."""
        return self.tried[self.terms].box


def choose(
    runs: Sequence[GreyRun], step_s: float, noise_k: float, tell: Callable[[str], None] = lambda text: None
) -> GreyChoice:
    """Grow a grey box over the runs. noise_k : of a reading, at least its resolution"""
    tried: dict[Terms, Tried] = {}

    def attempt(terms: Terms) -> None:
        if terms not in tried:
            tell(" + ".join(sorted(terms)) or "one mass")
            smaller = [own.box for key, own in tried.items() if key < terms and len(terms - key) == 1]
            near = min(smaller, key=lambda box: box.rmse_k, default=None)
            box = fit(terms, runs, step_s, noise_k, near)
            tried[terms] = Tried(box, left_out(box, runs))

    attempt(frozenset())
    best = frozenset[str]()
    while len(best) < MOST_TERMS:
        for terms in _next(best, runs):
            attempt(terms)
        found = _best(tried, [best, *(key for key in tried if len(key) == len(best) + 1)])
        if found == best:
            break
        best = found
    return GreyChoice(_best(tried, tried), tried)


def _best(tried: dict[Terms, Tried], keys: Iterable[Terms]) -> Terms:
    keys = list(keys)
    first = tried[min(keys, key=lambda key: tried[key].left_out_k)]
    near = []
    for key in keys:
        more, error = tried[key].behind(first)
        if not more > max(CLEARLY * error, MATTERS):
            near.append(key)
    closest = min(tried[key].box.rmse_k for key in near)
    close = [key for key in near if tried[key].box.rmse_k <= AS_CLOSE * closest]
    return min(close, key=lambda key: (len(tried[key].box.rates), tried[key].left_out_k))


def _next(terms: Terms, runs: Sequence[GreyRun]) -> list[Terms]:
    """Return structures with one more term, or another body in the place of one."""
    fan_moved = any(run.fan is not None and np.ptp(run.fan) > 0.0 for run in runs)
    more = [
        terms | {name}
        for name in RATES
        if name not in terms
        and not (name in BODIES and terms & BODIES)
        and not (name == "dead_time" and "heater_lag" not in terms)
        and (name != "fan" or fan_moved)
    ]
    if terms & BODIES:
        more += [terms - BODIES | {body} for body in sorted(BODIES - terms)]
    return more


def left_out(box: GreyBox, runs: Sequence[GreyRun]) -> Floats:
    """Return the mean square error of each block of rows that the fit did not see [K²]."""
    found: list[Floats] = []
    if len(runs) >= WHOLE_RUNS:
        for part in np.array_split(np.arange(len(runs)), min(FOLDS, len(runs))):
            again = fit_again(box, [run for i, run in enumerate(runs) if i not in part])
            found += [runs[i].temp - again.free_run(runs[i], again.start_of(runs[i])) for i in part]
    else:
        for begin, end in pairwise(SPLITS):
            rows = [(round(begin * len(run.temp)), round(end * len(run.temp))) for run in runs]
            past = [run.until(first) for run, (first, _) in zip(runs, rows, strict=True)]
            again = fit_again(box, past)
            for run, start, (first, last) in zip(runs, again.starts, rows, strict=True):
                found.append((run.temp - again.free_run(run, start))[first:last])
    each = max(1, BLOCKS // len(found))
    blocks = [block[np.isfinite(block)] for errors in found for block in np.array_split(errors, each)]
    return np.array([np.mean(block**2) for block in blocks if len(block)])
