"""The forecasts of a tick: score past forecasts, learn from the errors, roll each predictor out again."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from edge.core.horizons import steps_of
from edge.core.messages import Command, Decision, Forecast, ForecastSkill
from edge.core.predictor import Columns, Floats, Predictor
from edge.forecasts.conformal import Intervals
from edge.forecasts.scorer import Scorer, ahead_of, roll
from edge.forecasts.skill import RIVAL, SkillState, half_widths, skills, update_skill, without_rivals
from edge.models.validity import outside_steps


def is_outside(
    predictor: Predictor, history: Columns, controls: Floats, ahead: Columns, temps: Floats
) -> bool | None:
    """By the predictor's `validity`: the lowest and highest value of each column in the data of its fit.

    history, controls [N, 2], ahead : as the rollout had them; temps : what it returned [N] [°C]
    Returns : None for a predictor that knows no box
    """
    validity = getattr(predictor, "validity", None)
    if not validity:
        return None
    return bool(outside_steps(validity, history, controls[None], ahead, temps[None]).any())


HalfWidths = Callable[[str, str, Iterable[int]], Mapping[int, float]]  # name, version, horizons -> [K]


def forecasts(
    predictors: Mapping[str, Predictor],
    history: Columns,
    planned: Floats,
    step_s: float,
    half_widths: HalfWidths,
) -> dict[str, Forecast]:
    """One forecast per predictor, by a single rollout each. Never raises.

    history : `Estimator.history()`; the newest row is now
    planned : heater_duty and fan_on of each step from now on, [n, 2], n >= 1; the last row is held
    """
    steps = steps_of(step_s)
    if not steps:
        return {}
    longest = max(steps.values())
    held = np.broadcast_to(planned[-1], (max(0, longest - len(planned)), 2))
    controls = np.concatenate([planned[:longest], held]).astype(np.float64)
    return {
        name: _forecast(name, predictor, history, controls, step_s, steps, half_widths)
        for name, predictor in predictors.items()
    }


def planned_inputs(driven: Command, plan: Sequence[tuple[float, float]]) -> Floats:
    """Return the inputs from now on, [n, 2]: the plan where the board drives it, else the driven inputs held.

    plan : heater_duty and fan_on of each step as the controller wanted them, () where it has no plan
    """
    now = (driven.heater_duty, driven.fan)
    follows = bool(plan) and np.allclose(plan[0], now, atol=1e-6)
    return np.array(plan if follows else [now], dtype=np.float64)


def _forecast(
    name: str,
    predictor: Predictor,
    history: Columns,
    controls: Floats,
    step_s: float,
    steps: Mapping[int, int],
    half_widths: HalfWidths,
) -> Forecast:
    rolled = roll(predictor, history, controls, step_s)
    if rolled.temps is None:
        return Forecast(reason=rolled.reason)
    ahead = ahead_of(history, len(controls), step_s)
    outside = is_outside(predictor, history, controls, ahead, rolled.temps)
    return Forecast(
        temps={minutes: float(rolled.temps[count - 1]) for minutes, count in steps.items()},
        half_widths=half_widths(name, predictor.version, tuple(steps)),
        outside=outside,
    )


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

    def begin_anew(self) -> None:
        """Score no forecast from before now."""
        self._scorer.drop()

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
            widths = partial(half_widths, self.state, self._intervals)
            made = forecasts(self._active, history, planned, self._step_s, widths)
        return made, skills(self.state, self._all)

    def _set(
        self,
        active: Mapping[str, Predictor],
        intervals: Intervals | None,
        rivals: Mapping[str, Predictor] | None,
    ) -> None:
        self._active, self._intervals = dict(active), intervals or Intervals()
        self._all = self._active | {name + RIVAL: rival for name, rival in (rivals or {}).items()}
