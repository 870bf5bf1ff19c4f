"""What each effect that was named explains of runs that had no part in fitting it.

The training runs in two halves, every other one: the set with the effect and the one without are fitted to
one half and tell the other (Stone 1974, JRSS B 36: cross-validation), and the other way round.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.twin.diagnosis.candidates import Scored
from edge.twin.diagnosis.fitting import fit
from edge.twin.diagnosis.search import Search
from edge.twin.diagnosis.starts import settled
from edge.twin.diagnosis.trial import Trial
from edge.twin.recorded import Recorded

Indices = NDArray[np.intp]
FEWEST_RUNS = 2
ITERATIONS = 4  # from where all runs together ended


def held_out_gains(search: Search, final: Scored, names: Sequence[str]) -> dict[str, float]:
    """Nats by which left-out runs are likelier with each effect than without; empty for a single run."""
    count = len(search.runs.temp)
    if count < FEWEST_RUNS or not names:
        return {}
    sets = [final, *(search.sets.without(final, name) for name in names)]
    halves = np.arange(0, count, 2), np.arange(1, count, 2)
    told = sum(_told(sets, search.runs, *pair) for pair in (halves, halves[::-1]))
    return dict(zip(names, (np.asarray(told)[0] - np.asarray(told)[1:]).tolist(), strict=True))


def _told(sets: Sequence[Scored], runs: Recorded, fitted: Indices, left_out: Indices) -> NDArray[np.float64]:
    """Log likelihood of the runs that were left out, by each set [nats]."""
    trials = [replace(_of(item, fitted), file=item.fitted.file, free=item.fitted.free) for item in sets]
    found = fit(trials, _chosen(runs, fitted), ITERATIONS)
    still = [
        replace(_of(item, left_out), file=settled(half.file), free=())
        for item, half in zip(sets, found, strict=True)
    ]
    return np.array([item.log_likelihood for item in fit(still, _chosen(runs, left_out), 0)])


def _of(item: Scored, runs: Indices) -> Trial:
    """The set's trial with what acts on some of the runs."""
    trial = item.fitted.trial
    terms = tuple(replace(term, shape=term.shape[:, runs]) for term in trial.nuisances)
    return replace(trial, nuisances=terms)


def _chosen(runs: Recorded, which: Indices) -> Recorded:
    return Recorded(
        runs.temp[which],
        runs.duty[which],
        runs.fan[which],
        runs.ambient[which],
        {name: column[which] for name, column in runs.conditions.items()},
    )
