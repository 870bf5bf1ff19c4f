"""Is a wave worse than the boxes that wait? Pure, from hourly costs of both.

Each box is compared with itself before the wave, at the same hours of the day. The boxes of the wave are then
compared with boxes of their kind whose bundle stays, so that what the weather does to both drops out.

The bound on false stops is exact where each block's mean, given those before it, is not above the margin.
Hours of a box resemble each other, so `python -m bench.fleet_rollout` counts false stops too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from statistics import fmean

import numpy as np

# Shares of the largest bet that can't lose everything; capital is split evenly among them before the first
# value, so that no share has to be chosen after values were seen.
SHARES = np.array([0.03, 0.06, 0.12, 0.25, 0.5, 0.9])
# Far beyond any evidence that is asked for: a wave may be held for months, and JSON has no infinity.
MOST = 1e15
HOUR_S = 3600.0
DAY_H = 24
BLOCK_H = 1  # hours that make one value
# A box that is dearer or cheaper by more than this share counts as this share: of the six that a wave has at
# least, an odd one alone moves the mean by the usual margin. A bound of 0.3 let a bundle pass that made three
# boxes of four much dearer and the fourth cheaper.
BOUND = 0.6
SMALLEST_COST = 0.02  # a step [1]: below it, a share of the cost says nothing about a box
COMPARED_LEAST = 2  # boxes on each side


def evidence_above(values: Sequence[float], mean: float, bound: float) -> float:
    """Return the most that a capital of 1 ever became by bets that the values' mean is above `mean`.

    values : in order, each within -bound..bound and with a mean of at most `mean` given those before it
        where the bets are to be fair
    Errors : ValueError for a value or mean that is not within the bound
    """
    if not abs(mean) < bound:
        raise ValueError(f"fleet.rollout: a mean of {mean} is not within the bound {bound}")
    steps = np.asarray(values, dtype=np.float64)
    if not np.all(np.abs(steps) <= bound):  # NaN too
        raise ValueError(f"fleet.rollout: a value is not within -{bound}..{bound}")
    gains = 1.0 + np.outer(steps - mean, SHARES) / (bound + mean)
    with np.errstate(over="ignore"):
        capital = np.cumprod(gains, axis=0).mean(axis=1)
    return float(min(capital.max(initial=1.0), MOST))


def evidence_below(values: Sequence[float], mean: float, bound: float) -> float:
    """Return the same for bets that the mean is below `mean`."""
    return evidence_above([-value for value in values], -mean, bound)


@dataclass(frozen=True, slots=True)
class HourCost:
    """Mean cost of a step within an hour, as `edge.lab.cost`. begin_utc : a multiple of an hour"""

    begin_utc: float
    cost: float


class Verdict(Enum):
    """Outcome of a look at a wave; the values are the words of the log."""

    WAIT = "goes on"
    NOT_WORSE = "shown not worse"
    WORSE = "worse"


@dataclass(frozen=True, slots=True)
class JudgeRules:
    """Rules of a rollout.

    margin : share of the cost that the new bundle may be dearer by
    error : probability of a stop without harm, over all looks, kinds and waves of a rollout; and of calling
        a wave "not worse" although a kind of it is dearer by more than the margin
    waves : in a rollout; least_blocks : before a wave is let through, as long as a day
    """

    margin: float
    error: float
    waves: int
    least_blocks: int = DAY_H // BLOCK_H

    @property
    def safe_from(self) -> float:
        """Return the evidence that shows a kind to be safe.

        Every kind has to be shown: that one of them is called safe by mistake needs no share for each kind.
        """
        return self.waves / self.error


@dataclass(frozen=True, slots=True)
class KindJudgement:
    """A kind within a wave. difference : mean over its blocks, share of the cost; harm, safety : evidence"""

    blocks: int
    difference: float | None
    harm: float
    safety: float


@dataclass(frozen=True, slots=True)
class WaveJudgement:
    """A verdict, its reason and its figures by kind."""

    verdict: Verdict
    why: str
    kinds: Mapping[str, KindJudgement] = field(default_factory=dict)


def relative_change(costs: Sequence[HourCost], before: Sequence[HourCost], from_utc: float) -> float | None:
    """Return by which share the block from `from_utc` is dearer than the same hours of the days before it.

    None where an hour of the block is missing, or no hour before it was at the same time of a day.
    """
    hours = [from_utc + HOUR_S * k for k in range(BLOCK_H)]
    now = {hour.begin_utc: hour.cost for hour in costs}
    times = {_time_of_day(hour) for hour in hours}
    then = [hour.cost for hour in before if _time_of_day(hour.begin_utc) in times]
    if not then or any(hour not in now for hour in hours):
        return None
    usual = max(fmean(then), SMALLEST_COST)
    return fmean(now[hour] for hour in hours) / usual - 1.0


def difference(changed: Sequence[float], waiting: Sequence[float]) -> float | None:
    """Return by which share a block is dearer for boxes of the wave than for those that wait, within BOUND.

    None where too few boxes of either have a value.
    """
    if min(len(changed), len(waiting)) < COMPARED_LEAST:
        return None
    return _within(fmean(map(_within, changed)) - fmean(map(_within, waiting)))


def _within(share: float) -> float:
    return max(-BOUND, min(share, BOUND))


def judge(differences: Mapping[str, Sequence[float]], rules: JudgeRules) -> WaveJudgement:
    """Judge a wave. differences : of each kind in the wave, the blocks so far; none where nothing compares"""
    found = {kind: _judge_kind(values, rules) for kind, values in sorted(differences.items())}
    # An e-value of 1 / share refutes at `share`; the shares of all kinds and waves together are `error`.
    tests = max(len(found), 1) * rules.waves
    for kind, row in found.items():
        if row.harm >= tests / rules.error:
            why = f"kind {kind or '-'} is dearer by {row.difference:.0%}, evidence of harm {row.harm:.3g}"
            return WaveJudgement(Verdict.WORSE, why, found)
    safe = [kind for kind, row in found.items() if row.safety >= rules.safe_from]
    seen = min((row.blocks for row in found.values()), default=0)
    if found and len(safe) == len(found) and seen >= rules.least_blocks:
        return WaveJudgement(Verdict.NOT_WORSE, f"every kind is within {rules.margin:.0%}", found)
    unknown = ", ".join(kind or "-" for kind in found if kind not in safe) or "every kind"
    return WaveJudgement(Verdict.WAIT, f"not shown to be within {rules.margin:.0%}: {unknown}", found)


def _judge_kind(values: Sequence[float], rules: JudgeRules) -> KindJudgement:
    return KindJudgement(
        len(values),
        fmean(values) if values else None,
        evidence_above(values, rules.margin, BOUND),
        evidence_below(values, rules.margin, BOUND),
    )


def _time_of_day(utc: float) -> int:
    return int(utc // HOUR_S) % DAY_H
