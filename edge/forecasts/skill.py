"""How well each predictor has forecast: mean errors beside those of a reference, and the intervals' coverage.

Skill is 1 - MAE / MAE of the reference, both over the same forecasts; 0 is as good as it, 1 is perfect.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from edge.core.messages import ForecastSkill
from edge.core.predictor import Predictor
from edge.forecasts.conformal import Intervals, track
from edge.forecasts.scorer import PERSISTENCE, ScoredForecast

WINDOW_S = 86400.0  # means are plain up to a day of scored forecasts, then older ones fade over a day
PBM = "pbm"
RIVAL = ".rival"  # ends the name of a predictor that is scored beside the active one of the name before it


@dataclass(frozen=True, slots=True)
class ErrorPair:
    """Mean absolute errors of a predictor and of a reference on the same forecasts."""

    versions: tuple[str, str]  # predictor's and reference's: another one begins anew
    scored: int = 0
    mae_k: float = 0.0
    reference_mae_k: float = 0.0

    @property
    def skill(self) -> float | None:
        """None where the reference made no error."""
        return 1.0 - self.mae_k / self.reference_mae_k if self.reference_mae_k > 0.0 else None


@dataclass(frozen=True, slots=True)
class Width:
    """A predictor's interval at one horizon, as it follows the errors."""

    version: str
    half_width_k: float
    scored: int = 0
    covered: float = 0.0  # share of the measurements that were inside


@dataclass(frozen=True, slots=True)
class SkillState:
    """All that outlives the process."""

    pairs: Mapping[tuple[str, int, str], ErrorPair] = field(
        default_factory=dict
    )  # predictor, horizon, reference
    widths: Mapping[tuple[str, int], Width] = field(default_factory=dict)  # predictor, horizon


def update_skill(
    state: SkillState, scored: Sequence[ScoredForecast], intervals: Intervals, step_s: float
) -> SkillState:
    """Return the state after one tick's scored forecasts."""
    if not scored:
        return state
    by_name = {(one.predictor, one.horizon_min): one for one in scored}
    pairs, widths = dict(state.pairs), dict(state.widths)
    for (name, horizon), one in by_name.items():
        for reference in _references(name):
            other = by_name.get((reference, horizon))
            if other is not None:
                key = (name, horizon, reference)
                pairs[key] = _compare(pairs.get(key), one, other, step_s)
        width = _current(state, intervals, name, one.version, horizon)
        if width is not None:
            widths[name, horizon] = _follow(width, one.residual_k, step_s)
    return SkillState(pairs, widths)


def without_rivals(state: SkillState) -> SkillState:
    """Return the state for other rivals: scores against the former ones no longer count."""
    return replace(
        state, pairs={key: pair for key, pair in state.pairs.items() if not key[0].endswith(RIVAL)}
    )


def half_widths(
    state: SkillState, intervals: Intervals, name: str, version: str, horizons_min: Iterable[int]
) -> dict[int, float]:
    """Half widths now, by horizon, where there is a calibration [K]."""
    widths = {minutes: _current(state, intervals, name, version, minutes) for minutes in horizons_min}
    return {minutes: width.half_width_k for minutes, width in widths.items() if width is not None}


def skills(state: SkillState, predictors: Mapping[str, Predictor]) -> tuple[ForecastSkill, ...]:
    """One row per predictor and horizon that has been scored in its present version, shortest first."""
    rows = []
    for (name, horizon, reference), pair in sorted(state.pairs.items()):
        if reference != PERSISTENCE or name not in predictors or pair.versions[0] != predictors[name].version:
            continue
        beside_pbm = state.pairs.get((name, horizon, PBM))
        width = state.widths.get((name, horizon))
        rows.append(
            ForecastSkill(
                predictor=name,
                version=pair.versions[0],
                horizon_min=horizon,
                scored=pair.scored,
                mae_k=pair.mae_k,
                against_persistence=pair.skill,
                against_pbm=None if beside_pbm is None else beside_pbm.skill,
                half_width_k=None if width is None else width.half_width_k,
                covered=None if width is None else width.covered,
            )
        )
    return tuple(rows)


def _references(name: str) -> tuple[str, ...]:
    if name == PERSISTENCE:
        return ()
    known = (PERSISTENCE,) if name == PBM else (PERSISTENCE, PBM)
    return (*known, name.removesuffix(RIVAL)) if name.endswith(RIVAL) else known


def _compare(pair: ErrorPair | None, one: ScoredForecast, other: ScoredForecast, step_s: float) -> ErrorPair:
    versions = (one.version, other.version)
    if pair is None or pair.versions != versions:
        pair = ErrorPair(versions)
    count = pair.scored + 1
    share = max(1.0 / count, step_s / WINDOW_S)
    return ErrorPair(
        versions,
        count,
        pair.mae_k + share * (abs(one.residual_k) - pair.mae_k),
        pair.reference_mae_k + share * (abs(other.residual_k) - pair.reference_mae_k),
    )


def _current(state: SkillState, intervals: Intervals, name: str, version: str, horizon: int) -> Width | None:
    """Return the width of this version: the tracked one, else the calibrated one."""
    width = state.widths.get((name, horizon))
    if width is not None and width.version == version:
        return width
    calibrated = intervals.half_width(name, version, horizon)
    return None if calibrated is None else Width(version, calibrated)


def _follow(width: Width, residual_k: float, step_s: float) -> Width:
    count = width.scored + 1
    inside = float(abs(residual_k) <= width.half_width_k)
    share = max(1.0 / count, step_s / WINDOW_S)
    return replace(
        width,
        half_width_k=track(width.half_width_k, residual_k),
        scored=count,
        covered=width.covered + share * (inside - width.covered),
    )
