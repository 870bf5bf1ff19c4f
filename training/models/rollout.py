"""Free run of any predictor over a whole run from its first samples, and what it misses by."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Floats, Predictor
from edge.formats.run_file import RecordedRun, inside_names

START_ROWS = 10  # the paper's window: every model begins from these, whatever it needs of them


@dataclass(frozen=True, slots=True)
class RolloutErrors:
    """Errors of a forecast, predicted minus measured [K]."""

    mae_k: float
    rmse_k: float
    bias_k: float
    worst_k: float
    rows: int


def free_run(predictor: Predictor, run: RecordedRun) -> Floats:
    """Temperatures [rows - START_ROWS] [°C] from row START_ROWS on, none of them measured.

    The run's inputs and its room temperature are given, its air temperature after the first rows is not.
    """
    rows = len(run)
    if rows <= START_ROWS:
        raise DataError(f"{run.path}: {rows} rows; a free run needs more than {START_ROWS}")
    return _forecast(predictor, run, START_ROWS - 1, rows - 1)


def one_step(predictor: Predictor, run: RecordedRun) -> Floats:
    """Temperatures [rows - START_ROWS] [°C], each from measurements up to the row before."""
    steps = [
        _forecast(predictor, run, now, now + 1, first=now + 1 - START_ROWS)
        for now in range(START_ROWS - 1, len(run) - 1)
    ]
    return np.concatenate(steps)


def errors(predicted: Floats, run: RecordedRun) -> RolloutErrors:
    """Errors of `free_run` or `one_step`, over the rows where the temperature was measured.

    Errors : DataError where the prediction is not finite, or nothing was measured
    """
    lost = ~np.isfinite(predicted)
    if lost.any():
        raise DataError(f"{run.path}: the prediction is not finite from step {lost.argmax()} on")
    missed = predicted - run.columns["temp_air_c"][START_ROWS:]
    missed = missed[np.isfinite(missed)]
    if not missed.size:
        raise DataError(f"{run.path}: temp_air_c: nothing measured after row {START_ROWS}")
    return RolloutErrors(
        mae_k=float(np.abs(missed).mean()),
        rmse_k=float(np.sqrt((missed**2).mean())),
        bias_k=float(missed.mean()),
        worst_k=float(np.abs(missed).max()),
        rows=missed.size,
    )


def mean_free_run_mae(predictor: Predictor, runs: Sequence[RecordedRun]) -> float:
    """Mean over the runs of the MAE of their free runs [K]."""
    return float(np.mean([errors(free_run(predictor, run), run).mae_k for run in runs]))


def _forecast(predictor: Predictor, run: RecordedRun, now: int, last: int, first: int = 0) -> Floats:
    columns = inside_names(run)
    history = {name: values[first : now + 1] for name, values in columns.items()}
    ahead = {name: values[now:last] for name, values in columns.items()}
    controls = np.stack([ahead["heater_duty"], ahead["fan_on"]], axis=-1)
    return np.asarray(predictor.rollout(history, controls[None], ahead)[0])
