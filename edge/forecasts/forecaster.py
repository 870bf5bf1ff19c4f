"""Forecasts of each predictor from the rig's present state, under the planned inputs."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from edge.core.horizons import steps_of
from edge.core.messages import Command, Forecast
from edge.core.predictor import Columns, Floats, Predictor
from edge.forecasts.rollout import ahead_of, roll
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
    now = (driven.heater_duty, float(driven.fan_on))
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
