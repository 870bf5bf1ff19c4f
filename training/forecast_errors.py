"""Errors of forecasts over recorded runs, made and scored as the daemon makes and scores them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from edge.estimator import Estimator
from edge.forecasts.scorer import Scorer
from edge.messages import Command, Quality, Reading
from edge.models.base import Predictor
from edge.names import SIGNALS
from edge.run_file import Run
from edge.settings import Settings

Floats = NDArray[np.float64]
Errors = dict[tuple[str, int], list[Floats]]  # predictor, horizon [min] -> by run: residual, measured [n, 2]
PROCESSES = 2
STEP_S = 60.0


def errors_of(runs: Sequence[Run], predictors: Mapping[str, Predictor], processes: int = PROCESSES) -> Errors:
    """Residuals (measured minus forecast) [K] and what was measured [°C], of every tick, by run in order.

    The estimator runs with the predictor "arx", as the daemon's does; the inputs are those recorded.
    """
    one = partial(errors_of_run, predictors=predictors)
    if processes == 1:
        by_run = [one(run) for run in runs]
    else:
        with get_context("spawn").Pool(processes) as pool:
            by_run = pool.map(one, runs, chunksize=1)
    keys = sorted({key for found in by_run for key in found})
    return {key: [found.get(key, np.empty((0, 2))) for found in by_run] for key in keys}


def errors_of_run(run: Run, predictors: Mapping[str, Predictor]) -> dict[tuple[str, int], Floats]:
    """The same for one run, a row per scored forecast in the order of time."""
    settings = Settings()
    estimator = Estimator(settings.estimator, predictors["arx"], STEP_S, settings.control.ambient_default_c)
    scorer = Scorer(STEP_S)
    start_utc = run.start_utc or 0.0
    found = defaultdict(list)
    for row, time_s in enumerate(run.columns["time_s"].tolist()):
        estimator.update(_readings(run, row, time_s), time_s, start_utc + time_s)
        duty, fan_on = run.columns["heater_duty"][row], run.columns["fan_on"][row]
        estimator.record_sent(Command(float(duty), bool(fan_on)))
        for one in scorer.observe(predictors, estimator.history(), inputs_known=True):
            found[one.predictor, one.horizon_min].append((one.residual_k, one.measured_c))
    return {key: np.array(rows) for key, rows in found.items()}


def _readings(run: Run, row: int, time_s: float) -> dict[str, Reading]:
    readings = {}
    for name, signal in SIGNALS.items():
        value = run.columns[signal.key][row] if signal.key in run.columns else np.nan
        known = bool(np.isfinite(value))
        quality = Quality.GOOD if known else Quality.ABSENT
        readings[name] = Reading(name, float(value) if known else None, time_s, quality)
    return readings
