"""When a bundle has proved itself: pure, from the errors that two bundles made on the same ticks.

The bundle on trial is the shadow, or the active one while it is on probation against the one before it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from edge.core.predictor import Predictor
from edge.forecasts.skill import RIVAL, SkillState

WORSE = 1.05  # ratio of mean errors, over all models and horizons, from which a bundle is worse
WORSE_ONCE = 1.25  # the same for any single model at any single horizon
ERROR_FLOOR_K = 0.02  # two errors below a fifth of the sensor's resolution are equally good
_RATIO_MAX = 1000.0


@dataclass(frozen=True, slots=True)
class HorizonScore:
    """Mean absolute errors of one model at one horizon, in both bundles."""

    model: str  # "arx", "pbm", "lstm", "ham"
    horizon_s: float
    count: int  # forecasts that have met their measurement: the same ones in both bundles
    active_k: float  # mean absolute error of the active bundle [K]
    rival_k: float  # of the bundle beside it [K]


@dataclass(frozen=True, slots=True)
class Scores:
    """How two bundles have done since they run side by side."""

    active: str  # name in the store
    rival: str  # name in the store
    models: tuple[str, ...]  # that both bundles have: each must have been scored
    rows: Sequence[HorizonScore]


class TrialVerdict(Enum):
    """The verdict of the scores; the values are the words of the log."""

    WAIT = "goes on"
    PROMOTE = "promote"
    REJECT = "reject"
    MARK_GOOD = "mark good"
    ROLL_BACK = "roll back"


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict and its reason."""

    verdict: TrialVerdict
    why: str


def judge(scores: Scores, on_probation: bool, ticks: int) -> Judgement:
    """Decide about the bundle on trial.

    on_probation : the active bundle is on trial against the one before it; else the shadow is
    ticks : scored forecasts at every horizon before anything is decided
    Returns : WAIT, PROMOTE or REJECT for a shadow; WAIT, MARK_GOOD or ROLL_BACK on probation. A shadow that
        is neither better nor clearly worse goes on; an active bundle is kept unless it is worse.
    """
    if waiting := _missing_scores(scores, ticks):
        return Judgement(TrialVerdict.WAIT, waiting)
    ratios = [_ratio(row, on_probation) for row in scores.rows]
    mean = math.exp(sum(math.log(ratio) for ratio in ratios) / len(ratios))
    most, row = max(zip(ratios, scores.rows, strict=True), key=lambda pair: pair[0])
    tried, other = (scores.active, scores.rival) if on_probation else (scores.rival, scores.active)
    why = (
        f"errors of {tried} are {mean:.3f} times those of {other}, "
        f"at most {most:.3f} times ({row.model} at {row.horizon_s:g} s)"
    )
    worse = mean > WORSE or most > WORSE_ONCE
    if on_probation:
        return Judgement(TrialVerdict.ROLL_BACK if worse else TrialVerdict.MARK_GOOD, why)
    if worse:
        return Judgement(TrialVerdict.REJECT, why)
    return Judgement(TrialVerdict.PROMOTE if mean <= 1.0 else TrialVerdict.WAIT, why)


def _missing_scores(scores: Scores, ticks: int) -> str:
    """Return the reason why nothing can be decided yet, "" if there is none.

    A model that fails in one of the bundles is never scored: such a trial is for a person to end.
    """
    missing = sorted(set(scores.models) - {row.model for row in scores.rows})
    if missing or not scores.rows:
        return f"no forecast of {', '.join(missing) or 'any model'} has been scored in both bundles"
    row = min(scores.rows, key=lambda row: row.count)
    if row.count < ticks:
        return f"{row.count} of {ticks} forecasts are scored for {row.model} at {row.horizon_s:g} s"
    return ""


def _ratio(row: HorizonScore, on_probation: bool) -> float:
    """Error of the bundle on trial over the other's; no number counts as the largest error there is."""
    tried, other = (row.active_k, row.rival_k) if on_probation else (row.rival_k, row.active_k)
    if not math.isfinite(tried):
        return _RATIO_MAX
    if not math.isfinite(other):
        return 1.0 / _RATIO_MAX
    ratio = max(tried, ERROR_FLOOR_K) / max(other, ERROR_FLOOR_K)
    return min(max(ratio, 1.0 / _RATIO_MAX), _RATIO_MAX)


def rival_rows(
    state: SkillState, active: Mapping[str, Predictor], rivals: Mapping[str, Predictor]
) -> tuple[HorizonScore, ...]:
    """Return a row per horizon and model of both bundles, in their present
    versions, the shortest horizon first.
    """
    rows = []
    for (name, horizon, reference), pair in sorted(state.pairs.items(), key=lambda item: item[0][1]):
        if name != reference + RIVAL or reference not in active or reference not in rivals:
            continue
        if pair.versions == (rivals[reference].version, active[reference].version):
            rows.append(
                HorizonScore(reference, 60.0 * horizon, pair.scored, pair.reference_mae_k, pair.mae_k)
            )
    return tuple(rows)
