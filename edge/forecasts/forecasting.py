"""The forecasts' part of a tick: score what has come true, learn from it, forecast again."""

from collections.abc import Iterable, Mapping

from edge.core.messages import Command, Decision, Forecast, ForecastSkill
from edge.core.predictor import Columns, Predictor
from edge.forecasts.conformal import Intervals
from edge.forecasts.forecaster import forecasts, planned_inputs
from edge.forecasts.scorer import Scorer
from edge.forecasts.skill import RIVAL, SkillState, half_widths, skills, update_skill, without_rivals


class Forecasting:
    """The active predictors, their rivals, and how well they do.

    active : by model name ("arx", "pbm", ...): forecast at every tick and scored
    rivals : by the same names: scored beside the active ones, and nothing else
    intervals : of the active ones
    state : of the process before
    """

    def __init__(
        self,
        step_s: float,
        active: Mapping[str, Predictor],
        intervals: Intervals | None = None,
        rivals: Mapping[str, Predictor] | None = None,
        state: SkillState | None = None,
    ) -> None:
        self._step_s = step_s
        self._scorer = Scorer(step_s)
        self.state = state or SkillState()
        self._set(active, intervals, rivals)

    def serve(
        self,
        active: Mapping[str, Predictor],
        intervals: Intervals | None = None,
        rivals: Mapping[str, Predictor] | None = None,
    ) -> None:
        """Go on with other predictors from the next tick on; a version's skill is its own, a trial begins."""
        self.state = without_rivals(self.state)
        self._set(active, intervals, rivals)

    def tick(
        self, history: Columns, decision: Decision, driven: Command, confirmed: bool
    ) -> tuple[dict[str, Forecast], tuple[ForecastSkill, ...]]:
        """Return the forecasts from now on, and the skill so far. No failure of a predictor raises.

        history : `Estimator.history()` after `record_sent(driven)`
        confirmed : the board said that it drives `driven`
        """
        scored = self._scorer.observe(self._all, history, confirmed)
        self.state = update_skill(self.state, scored, self._intervals, self._step_s)
        made: dict[str, Forecast] = {}
        if len(history["temp_air"]):
            planned = planned_inputs(driven, decision.plan)
            made = forecasts(self._active, history, planned, self._step_s, self._half_widths)
        return made, skills(self.state, self._all)

    def _set(
        self,
        active: Mapping[str, Predictor],
        intervals: Intervals | None,
        rivals: Mapping[str, Predictor] | None,
    ) -> None:
        self._active, self._intervals = dict(active), intervals or Intervals()
        self._all = self._active | {name + RIVAL: rival for name, rival in (rivals or {}).items()}

    def _half_widths(self, name: str, version: str, horizons_min: Iterable[int]) -> dict[int, float]:
        return half_widths(self.state, self._intervals, name, version, horizons_min)
