"""Costs of plans by a predictor's own rollouts."""

from dataclasses import dataclass, replace

import numpy as np

from edge.controllers.mixed_integer.problem import Ints, PlanningProblem
from edge.controllers.mpc import LIMIT_WEIGHT, pad
from edge.core.controller import Columns, Context, Floats
from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.core.predictor import Predictor
from edge.twin.warm_start import hold as last_known

_DUTIES = np.linspace(0.0, 1.0, 6)  # between which the duty that holds a temperature is interpolated
_STOOD_ROWS = 30  # for a model that looks back: how long the box has stood at that temperature


@dataclass(frozen=True, slots=True, eq=False)
class PlanRollouts:
    """Plans of one context by one predictor.

    goal : the planning problem whose costs and rules hold; its own forecast does not
    ahead : of all N + M steps; `offset` [K/step] is what the predictor adds to every step and feeds back
    held : heater duty over the tail
    """

    model: Predictor
    history: Columns
    ahead: Columns
    goal: PlanningProblem
    held: float

    def temperatures(self, levels: Ints, fan: Ints) -> Floats:
        """Air temperature after each step of plans [B, N], the tail's too: [B, N + M] [°C].

        Raises : DataError naming the predictor when it fails or forecasts what is no number
        """
        controls = np.zeros((len(levels), len(self.goal.reference), 2))
        controls[:, : self.goal.horizon, 0] = levels / HEATER_LEVELS
        controls[:, : self.goal.horizon, 1] = fan
        controls[:, self.goal.horizon :, 0] = self.held
        return forecast(self.model, self.history, controls, self.ahead)


def plan_rollouts(context: Context, model: Predictor, linear: PlanningProblem, held: float) -> PlanRollouts:
    """Return the rollouts and costs for a context.

    linear : the linear planner's problem for it, of which reference, weights and limits are taken
    held : a first guess of the duty that holds the reference
    """
    ahead = ahead_with_offset(context, len(linear.reference))
    if linear.tail:
        held = _holding_duty(context, model, float(linear.reference[-1]), held, linear.tail)
    return PlanRollouts(
        model=model,
        history=pad(context.history, model.rows_needed),
        ahead=ahead,
        goal=replace(linear, limit_weight=LIMIT_WEIGHT),
        held=min(held, context.limits.heater_max_duty),
    )


def forecast(model: Predictor, history: Columns, controls: Floats, ahead: Columns) -> Floats:
    """Roll a predictor out, [B, N] [°C]. Errors: DataError with its name, however it fails"""
    try:
        temps = model.rollout(history, controls, ahead)
    except Exception as error:  # of any library behind the seam; the fallback controller decides then
        raise DataError(f"{model.name} {model.version}: {error}") from error
    if temps.shape != controls.shape[:2]:
        raise DataError(
            f"{model.name} {model.version}: {temps.shape} temperatures for {controls.shape[:2]} steps"
        )
    if not np.isfinite(temps).all():
        raise DataError(f"{model.name} {model.version}: a forecast is no number")
    return np.asarray(temps, dtype=np.float64)


def ahead_with_offset(context: Context, steps: int) -> Columns:
    """Return the columns of the coming steps: measured values hold, time goes on."""
    ahead = {
        name: np.full(steps, last_known(column)[-1])
        for name, column in context.history.items()
        if name not in ("temp_air", "temp_air_measured", "heater_duty", "fan_on")
    }
    for name in ahead.keys() & {"time_s", "utc"}:
        ahead[name] = ahead[name] + context.step_s * np.arange(steps)
    return ahead | {
        "temp_ambient": np.full(steps, context.estimate.temp_ambient),
        "offset": np.full(steps, context.estimate.offset),
    }


def _holding_duty(context: Context, model: Predictor, temp_air: float, guess: float, steps: int) -> float:
    """Heater duty 0..1 that holds `temp_air` [°C] over so many steps, fan off, by the predictor's own word.

    guess : the duty at which the box is taken to have stood there before
    """
    rows = max(model.rows_needed, _STOOD_ROWS)
    stood = {key: np.full(rows, column[-1]) for key, column in context.history.items()}
    stood |= {
        "temp_air": np.full(rows, temp_air),
        "temp_ambient": np.full(rows, context.estimate.temp_ambient),
        "heater_duty": np.full(rows, guess),
        "fan_on": np.zeros(rows),
    }
    ahead = ahead_with_offset(context, steps)
    controls = np.zeros((len(_DUTIES), steps, 2))
    controls[:, :, 0] = _DUTIES[:, None]
    off = forecast(model, stood, controls, ahead).mean(axis=1) - temp_air
    return float(np.interp(0.0, np.maximum.accumulate(off), _DUTIES))
