"""Errors of forecasts over recorded runs, made and scored as the daemon makes and scores them."""

import pickle
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import Settings
from edge.core.messages import Command, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.core.predictor import Predictor
from edge.forecasts.scorer import Scorer
from edge.formats.run_file import RecordedRun
from edge.models.arx_file import read_arx
from edge.models.ham import read_ham
from edge.models.lstm import read_lstm
from edge.models.pbm import Pbm, read_twin
from edge.tick.estimator import Estimator
from training.sweep import sweep

Floats = NDArray[np.float64]
Load = Callable[[], Mapping[str, Predictor]]
Errors = dict[tuple[str, int], list[Floats]]  # predictor, horizon [min] -> by run: residual, measured [n, 2]
STEP_S = 60.0


def predictors_in(folder: Path | None) -> dict[str, Predictor]:
    """Return the models of a bundle's files, the ARX model first: the
    estimator runs with it. Errors: DataError
    """
    if folder is None:
        return {"arx": read_arx(), "pbm": Pbm()}
    twin = read_twin(folder / "twin.yaml")
    found: dict[str, Predictor] = {"arx": read_arx(folder / "arx.json"), "pbm": twin}
    if (folder / "lstm.onnx").exists():
        found["lstm"] = read_lstm(folder / "lstm.onnx")
    if (folder / "ham.onnx").exists():
        found["ham"] = read_ham(folder / "ham.onnx", twin.twin.sha256)
    return found


def errors_of(runs: Sequence[RecordedRun], load: Load, workers: int = 2, dask: str | None = None) -> Errors:
    """Residuals (measured minus forecast) [K] and what was measured [°C], of every tick, by run in order.

    load : makes the predictors, once in each process: an ONNX session can't be handed over
    """
    if workers or dask:
        key = pickle.dumps(load)
        by_run = sweep(_errors_of_run, [(key, run) for run in runs], workers, dask)
    else:
        predictors = load()
        by_run = [errors_of_run(run, predictors) for run in runs]
    keys = sorted({key for found in by_run for key in found})
    return {key: [found.get(key, np.empty((0, 2))) for found in by_run] for key in keys}


def errors_of_run(run: RecordedRun, predictors: Mapping[str, Predictor]) -> dict[tuple[str, int], Floats]:
    """Return the errors of one run, a row per scored forecast in the order of time.

    The estimator runs with the predictor "arx", as the daemon's does; the inputs are those recorded.
    """
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


def _readings(run: RecordedRun, row: int, time_s: float) -> dict[str, Reading]:
    readings = {}
    for name, signal in SIGNALS.items():
        value = run.columns[signal.key][row] if signal.key in run.columns else np.nan
        known = bool(np.isfinite(value))
        quality = ReadingQuality.GOOD if known else ReadingQuality.ABSENT
        readings[name] = Reading(name, float(value) if known else None, time_s, quality)
    return readings


@lru_cache(1)
def _load(key: bytes) -> Mapping[str, Predictor]:
    load: Load = pickle.loads(key)
    return load()


def _errors_of_run(job: tuple[bytes, RecordedRun]) -> dict[tuple[str, int], Floats]:
    key, run = job
    return errors_of_run(run, _load(key))
