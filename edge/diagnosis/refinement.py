"""Sets of effects fitted with noise levels of their own, from where they were found and from the beginning.

A likelihood has several tops. While effects are missing, the twin does best with noise that swallows most of
what was measured, and its values follow; a set that is then grown from there stays on that slope. So a set
with that much noise, or with several effects, is fitted once more as if nothing had been found before.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from edge.diagnosis.fitting import fit
from edge.diagnosis.noise_levels import FIRST_FACTOR, NEAR_FACTOR, find_levels, first_levels, level_prior
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, Trial
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

REFITTED, AFRESH = 3, 8  # iterations, from where a set was found and from the beginning
AGAIN = 2  # sets of a round that may begin again
LOUD = 3.0  # times the usual heat noise: no twin that lacks nothing has that much
SEVERAL = 3  # effects, beside which another one may change what the first ones were taken for


def refine(
    trials: Sequence[Trial],
    given: TwinFile,
    runs: RunBatch,
    again: int = AGAIN,
    shared: SideBySide | None = None,
) -> list[FittedTwin]:
    """Return the likelier fit of each trial, in the order given.

    given : the twin as it was before anything was added; again : how many, the best, may begin again
    """
    shared = shared or SideBySide()
    found = shared.map(partial(_level, given=given, runs=runs, first=REFITTED), trials)
    doubtful = [i for i, item in enumerate(found) if again and _doubtful(item, given, runs)]
    best = sorted(doubtful, key=lambda i: -_worth(found[i], given, runs))[:again]
    if best:
        fresh = [begin(trials[i], given, runs) for i in best]
        others = shared.map(partial(_level, given=given, runs=runs, first=AFRESH), fresh)
        for i, other in zip(best, others, strict=True):
            if likelihood(other, given) > likelihood(found[i], given):
                found[i] = other
    return found


def likelihood(found: FittedTwin, given: TwinFile) -> float:
    """In nats, the prior of its noise levels included."""
    return found.log_likelihood + level_prior(found.trial.levels, given)


def _level(trials: Sequence[Trial], given: TwinFile, runs: RunBatch, first: int) -> list[FittedTwin]:
    """Fitted, and then twice with better noise. first : iterations before"""
    found = fit(trials, runs, first)
    for factor in (FIRST_FACTOR, NEAR_FACTOR):
        found = fit(find_levels(found, given, runs, factor), runs, REFITTED)
    return found


def _worth(found: FittedTwin, given: TwinFile, runs: RunBatch) -> float:
    """Likelihood less what its values may explain by chance (BIC) [nats]."""
    rows = runs.measured.sum()
    return likelihood(found, given) - 0.5 * len(found.free) * float(np.log(rows))


def _doubtful(found: FittedTwin, given: TwinFile, runs: RunBatch) -> bool:
    added = found.file.effects.keys() - given.effects.keys()
    usual = first_levels(given, runs).heat_w
    return len(added) >= SEVERAL or found.trial.levels.heat_w > LOUD * usual


def begin(trial: Trial, given: TwinFile, runs: RunBatch) -> Trial:
    """With its free values where a fit begins, and the noise that is usual."""
    known = given.values()
    starts: dict[Place, Value] = {}
    for item in trial.free or ():
        if item.place in known:
            starts[item.place] = known[item.place]
        else:
            starts[item.place] = Value(given.usual(item.place).start, fit=True)
    return replace(trial, file=trial.file.with_values(starts), levels=first_levels(given, runs))
