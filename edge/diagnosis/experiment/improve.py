"""Which experiment is worth most: of all candidates first, then by small changes of the best one."""

from collections import Counter
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from edge.core.names import HEATER_LEVELS
from edge.diagnosis.experiment.families import FEWEST_ROWS, SEED, ExperimentCandidate
from edge.diagnosis.experiment.limits import ExperimentLimits
from edge.diagnosis.experiment.separation import Separation
from edge.diagnosis.experiment.sequence import Sequence, SequenceInputs, SequencePart, inputs_of, rows_of

Floats = NDArray[np.float64]
HOUR = float(np.log(2.0))  # what an hour of the rig is worth: it must double the evidence
SAME_NATS = 0.3  # below it, by every experiment, two models say the same
STRONGEST = 2  # levels of a candidate that are looked at: the strongest that stay cool enough
PASSES, TRIED = 4, 16
SHIFTS, DUTY_CHANGES = (-4, -2, -1, 1, 2, 4), (-4, -2, -1, 1, 2, 4)  # rows, and steps of the duty


@dataclass(frozen=True, slots=True, eq=False)
class Cool:
    """Experiments that safety lets pass as they are, and the warmest temperature predicted for each [B]."""

    candidates: tuple[ExperimentCandidate, ...]
    inputs: SequenceInputs
    highest_c: Floats

    def choose(self, which: NDArray[np.intp]) -> "Cool":
        """Return the experiments that `which` selects."""
        kept = tuple(self.candidates[i] for i in which)
        return Cool(kept, self.inputs.choose(which), self.highest_c[which])

    def strongest(self) -> "Cool":
        """Return the experiments of the highest levels of each family and duration, which come first."""
        seen: Counter[tuple[str, int]] = Counter()
        which = []
        for i, item in enumerate(self.candidates):
            kind = (item.what, rows_of(item.sequence))
            seen[kind] += 1
            if seen[kind] <= STRONGEST:
                which.append(i)
        return self.choose(np.array(which, dtype=np.intp))


@dataclass(frozen=True, slots=True, eq=False)
class ExperimentScores:
    """The expected evidence of each experiment for each pair, [pairs, B]."""

    cool: Cool
    log_odds: Floats

    def worth(self, weights: Floats) -> Floats:
        """Mean logarithm of the log odds, less the time it takes [B]: what is hard to tell counts most.

        weights : [pairs], their sum is 1
        """
        hours = self.cool.inputs.within.sum(axis=1) * self.cool.inputs.row_s / 3600.0
        return np.asarray(weights @ np.log1p(self.log_odds) - HOUR * hours)

    def best(self, weights: Floats) -> "ExperimentScores":
        """Return the experiment of the highest value."""
        i = int(np.argmax(self.worth(weights)))
        return ExperimentScores(self.cool.choose(np.array([i])), self.log_odds[:, i : i + 1])


def cool(found: Separation, tried: Many[ExperimentCandidate], limits: ExperimentLimits) -> Cool | None:
    """Those within all limits; None where there are none."""
    if not tried:
        return None
    inputs = inputs_of([item.sequence for item in tried], limits, found.row_s)
    highest_c = np.full(len(tried), np.inf)
    which = np.flatnonzero(inputs.allowed)
    if len(which):
        shown = found.predicted_c(inputs.choose(which))
        highest_c[which] = np.where(np.isfinite(shown), shown, np.inf).max(axis=(0, 2))
    kept = np.flatnonzero(highest_c <= limits.highest_c)
    return Cool(tuple(tried), inputs, highest_c).choose(kept) if len(kept) else None


def evaluate(found: Separation, items: Cool) -> ExperimentScores:
    """Return the expected evidence of each experiment."""
    return ExperimentScores(items, found.log_odds(items.inputs))


def improve(
    found: Separation, first: ExperimentScores, weights: Floats, limits: ExperimentLimits
) -> ExperimentScores:
    """Search near the first experiment; return the best one found, never a worse one."""
    random, best = np.random.default_rng(SEED), first
    most = int(limits.longest_s / found.row_s)
    for _ in range(PASSES):
        (now,) = best.cool.candidates
        near = [_change(now.sequence, random, most) for _ in range(TRIED)]
        passed = cool(found, [ExperimentCandidate(now.what, item) for item in near], limits)
        if passed is None:
            continue
        other = evaluate(found, passed).best(weights)
        if other.worth(weights)[0] > best.worth(weights)[0]:
            best = other
    return best


def _change(sequence: Sequence, random: Generator, most: int) -> Sequence:
    """One or two small changes."""
    for _ in range(int(random.integers(1, 3))):
        changed = CHANGES[int(random.integers(len(CHANGES)))](list(sequence), random)
        if FEWEST_ROWS <= rows_of(changed) <= most:
            sequence = changed
    return sequence


def _moved_switch(parts: list[SequencePart], random: Generator) -> Sequence:
    """Move a switch to an earlier or later row; the last one is the end."""
    i, by = int(random.integers(len(parts))), int(random.choice(SHIFTS))
    parts[i] = parts[i]._replace(rows=max(parts[i].rows + by, 1))
    if i + 1 < len(parts):
        parts[i + 1] = parts[i + 1]._replace(rows=max(parts[i + 1].rows - by, 1))
    return tuple(parts)


def _other_duty(parts: list[SequencePart], random: Generator) -> Sequence:
    i, by = int(random.integers(len(parts))), int(random.choice(DUTY_CHANGES)) / HEATER_LEVELS
    parts[i] = parts[i]._replace(duty=min(max(parts[i].duty + by, 0.0), 1.0))
    return tuple(parts)


def _other_fan(parts: list[SequencePart], random: Generator) -> Sequence:
    i = int(random.integers(len(parts)))
    parts[i] = parts[i]._replace(fan=1.0 - parts[i].fan)
    return tuple(parts)


CHANGES = (_moved_switch, _moved_switch, _other_duty, _other_fan)
