"""Short experiments that have told such rivals apart, in a few durations and amplitudes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from edge.diagnosis.experiment.limits import ExperimentLimits
from edge.diagnosis.experiment.sequence import Sequence, SequencePart

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
