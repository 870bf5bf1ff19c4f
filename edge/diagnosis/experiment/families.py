"""Families of short experiments that tell rivals apart, and the search for the one that is worth most."""

from collections import Counter
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from edge.core.names import HEATER_LEVELS
from edge.diagnosis.experiment.separation import Separation
from edge.diagnosis.experiment.sequence import (
    ExperimentLimits,
    Sequence,
    SequenceInputs,
    SequencePart,
    inputs_of,
    rows_of,
)

DURATIONS = (1.0 / 3.0, 2.0 / 3.0, 1.0)  # of the longest
LEVELS = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1)  # of the duty
STAIRS = (2, 4, 1, 5, 3)  # fifths of the level
FEWEST_ROWS = 12
FAST_S, QUICK_S = 300.0, (120.0, 360.0)
SEED = 7  # of the pseudo-random sequences: the same data give the same experiment


@dataclass(frozen=True, slots=True)
class Frame:
    """The frame of a sequence: rows, the heater's level, the fan's shortest
    state [rows], a row's length [s].
    """

    rows: int
    level: float
    dwell: int
    row_s: float

    def lengths(self, count: int, shortest: int = 1) -> list[int]:
        """As equal as they can be, no more than fit."""
        count = max(1, min(count, self.rows // max(shortest, 1)))
        edges = np.linspace(0, self.rows, count + 1).round().astype(int)
        return [int(length) for length in np.diff(edges)]

    def of(self, seconds: float) -> int:
        """Rows of a time, one at least."""
        return max(1, round(seconds / self.row_s))


@dataclass(frozen=True, slots=True)
class ExperimentCandidate:
    """A sequence and what it is, as a sentence's beginning."""

    what: str
    sequence: Sequence


def fan_switching(frame: Frame) -> Sequence:
    """Loss against leakage, heater lag against sensor lag."""
    return tuple(
        SequencePart(length, frame.level, float(i % 2))
        for i, length in enumerate(frame.lengths(8, frame.dwell))
    )


def staircase(frame: Frame, fan: float = 0.0) -> Sequence:
    """Efficiency, sag, saturation."""
    stairs = zip(frame.lengths(len(STAIRS), frame.dwell), STAIRS, strict=False)
    return tuple(SequencePart(length, frame.level * fifths / len(STAIRS), fan) for length, fifths in stairs)


def aired_staircase(frame: Frame) -> Sequence:
    """Raise the heater in steps while the fan removes the heat, so that the upper levels can be reached."""
    return staircase(frame, 1.0)


def switched_staircase(frame: Frame) -> Sequence:
    """Each level with the fan off and on."""
    stairs = zip(frame.lengths(2 * len(STAIRS), frame.dwell), np.repeat(STAIRS, 2), strict=False)
    return tuple(
        SequencePart(length, frame.level * float(fifths) / len(STAIRS), float(i % 2))
        for i, (length, fifths) in enumerate(stairs)
    )


def random_fan(frame: Frame) -> Sequence:
    """Switch the fan at random in a warm greenhouse, which reveals the fan's own dynamics."""
    random = np.random.default_rng(SEED)
    parts = [SequencePart(max(frame.rows // 4, 1), frame.level, 0.0)]
    left, fan = frame.rows - parts[0].rows, 1.0
    while left > 0:
        seconds = float(random.uniform(*QUICK_S))
        length = min(max(frame.of(seconds), frame.dwell), left)
        parts.append(SequencePart(length, frame.level, fan))
        left, fan = left - length, 1.0 - fan
    return tuple(parts)


def slow_duty(frame: Frame) -> Sequence:
    """Switch the duty slowly, which reveals heat stores."""
    return tuple(
        SequencePart(length, frame.level * ((i + 1) % 2), 0.0) for i, length in enumerate(frame.lengths(6))
    )


def fast_duty(frame: Frame) -> Sequence:
    """Switch the duty fast, which reveals lags and dead times."""
    count = max(frame.rows // frame.of(FAST_S), 2)
    return tuple(
        SequencePart(length, frame.level * ((i + 1) % 2), 0.0)
        for i, length in enumerate(frame.lengths(count))
    )


def aired_duty(frame: Frame) -> Sequence:
    """Switch the duty fast with the fan on, which reveals lags in a greenhouse that answers fast."""
    lengths = frame.lengths(10, frame.dwell)
    return tuple(SequencePart(length, frame.level * ((i + 1) % 2), 1.0) for i, length in enumerate(lengths))


def cool_down(frame: Frame) -> Sequence:
    """Heat, then cool down: stored heat comes back and decays, constant heat stays."""
    warm = max(frame.rows // 3, 1)
    return SequencePart(warm, frame.level, 0.0), SequencePart(frame.rows - warm, 0.0, 0.0)


def lamp(frame: Frame) -> Sequence:
    """Switch the light with a steady heater."""
    return tuple(
        SequencePart(length, frame.level, 0.0, float(i % 2))
        for i, length in enumerate(frame.lengths(6, frame.dwell))
    )


Family = Callable[[Frame], Sequence]
FAMILIES: dict[str, Family] = {
    "fan switching with the heater steady": fan_switching,
    "a staircase of five duty levels": staircase,
    "a staircase of five duty levels with the fan on": aired_staircase,
    "a staircase of five duty levels, each with the fan off and on": switched_staircase,
    "a pseudo-random fan sequence in a warm box": random_fan,
    "slow steps of the duty": slow_duty,
    "fast steps of the duty": fast_duty,
    "steps of the duty with the fan on": aired_duty,
    "a long cool-down": cool_down,
}
LIT: dict[str, Family] = {"the light on and off with the heater steady": lamp}


def candidates(limits: ExperimentLimits, row_s: float, lit: bool) -> list[ExperimentCandidate]:
    """All, weakest level last; none where the time is too short. lit : whether the light may matter"""
    found = []
    families = {**FAMILIES, **(LIT if lit else {})}
    lengths = sorted({int(share * limits.longest_s / row_s) for share in DURATIONS})
    for what, family in families.items():
        for rows in lengths:
            if rows >= FEWEST_ROWS:
                levels = dict.fromkeys(limits.duty(level) for level in LEVELS)
                frames = [Frame(rows, level, limits.dwell_rows(row_s), row_s) for level in levels if level]
                found += [ExperimentCandidate(what, family(frame)) for frame in frames]
    return found


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
