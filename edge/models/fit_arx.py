"""An ARX model from recorded runs: least squares, orders chosen by free-run error on other runs."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.input_file import TABLE, read_file
from edge.formats.run_file import RecordedRun, refuse_test, resample
from edge.models.arx import Arx, FanInput

Floats = NDArray[np.float64]
ORDERS = tuple((p, q) for p in (1, 2, 3, 4, 6, 8, 12) for q in (1, 2, 3, 4))
FREE_RUN_STEPS = 30
_ROWS_PER_COEFFICIENT = 5  # fewer rows than this times the coefficients are no fit
_ROUNDING_K = 1e-6  # errors below this are no reason to choose
_TOLERANCE = 1.01  # the fewest coefficients within 1 % of the least free-run error are chosen


@dataclass(frozen=True, slots=True)
class OrderScore:
    """One pair of orders on the validation runs."""

    p: int
    q: int
    rmse_k: float  # free run over FREE_RUN_STEPS, restarted at each end


@dataclass(frozen=True, slots=True)
class ArxFit:
    """The chosen model and how it was chosen."""

    model: Arx
    rows: int  # that the coefficients were fitted on
    one_step_rmse_k: float  # on those rows
    free_run_rmse_k: float  # on the validation runs
    scores: tuple[OrderScore, ...]


def fit_arx(
    training: Sequence[RecordedRun],
    validation: Sequence[RecordedRun],
    step_s: float,
    orders: Sequence[tuple[int, int]] = ORDERS,
    fan_input: FanInput | None = "on",
    with_ambient: bool = True,
) -> ArxFit:
    """Fit models of several orders (p, q); return the one that forecasts the validation runs best.

    step_s : period of the model; runs recorded at another one are resampled
    fan_input : see `Arx`; None leaves the fan out (its constant effect goes into the intercept)
    with_ambient : False leaves the room temperature out, in the same way
    Raises : DataError for a test run, a fan by the excess without the room temperature, a missing or constant
        column, too few rows, a period longer than `step_s`
    """
    if fan_input == "excess" and not with_ambient:
        raise DataError("fit: the fan's excess over the room needs the room temperature as an input")
    inputs = [
        "heater_duty",
        *(["fan_on"] if fan_input else []),
        *(["temp_ambient_c"] if with_ambient else []),
    ]
    if not training or not validation:
        raise DataError("fit: needs at least one training and one validation run")
    for run in (*training, *validation):  # the orders are chosen on the latter: that is fitting too
        refuse_test(run)
    train = [_columns(run, step_s, inputs) for run in training]
    valid = [_columns(run, step_s, inputs) for run in validation]
    for key in inputs:
        _refuse_constant(key, train)
    tried = [(p, q, _fit_one(train, p, q, step_s, fan_input, with_ambient)) for p, q in orders]
    fits = [(p, q, fit) for p, q, fit in tried if fit is not None]
    if not fits:
        raise DataError(
            f"fit: too few rows without a gap: {_ROWS_PER_COEFFICIENT} are needed per coefficient"
        )
    scores = tuple(OrderScore(p, q, free_run_rmse(fit[0], valid)) for p, q, fit in fits)
    errors = np.array([score.rmse_k for score in scores])
    if not np.isfinite(errors).any():
        raise DataError(f"fit: no stretch of {FREE_RUN_STEPS} steps without a gap in the validation runs")
    # The smallest order that is nearly as good: the best by a hair is the best by chance.
    good = [i for i, error in enumerate(errors) if error <= _TOLERANCE * np.nanmin(errors) + _ROUNDING_K]
    chosen = min(good, key=lambda i: (scores[i].p + scores[i].q, errors[i]))
    model, rows, one_step = fits[chosen][2]
    return ArxFit(model, rows, one_step, float(errors[chosen]), scores)


def free_run_rmse(model: Arx, runs: Sequence[Mapping[str, Floats]], steps: int = FREE_RUN_STEPS) -> float:
    """Error of forecasts of up to `steps` steps with the recorded inputs, from every `steps`-th row [K].

    runs : columns at the model's period, border keys. NaN when nothing can be compared.
    """
    errors: list[Floats] = []
    for run in runs:
        temp = run["temp_air_c"]
        for now in range(model.rows_needed - 1, len(temp) - 1, steps):
            past = slice(now + 1 - model.rows_needed, now + 1)
            coming = slice(now, min(now + steps, len(temp) - 1))
            controls = np.stack([run["heater_duty"][coming], run["fan_on"][coming]], axis=-1)
            history = {
                "temp_air": temp[past],
                "heater_duty": run["heater_duty"][past],
                "fan_on": run["fan_on"][past],
                "temp_ambient": run["temp_ambient_c"][past],
            }
            ahead = {"temp_ambient": run["temp_ambient_c"][coming]}
            forecast = model.rollout(history, controls[None], ahead)[0]
            errors.append(forecast - temp[coming.start + 1 : coming.stop + 1])
    squares = np.concatenate(errors) ** 2 if errors else np.array([])
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def provenance(
    fit: ArxFit, training: Sequence[RecordedRun], validation: Sequence[RecordedRun], command: str
) -> dict[str, Any]:
    """Return the model's origin as JSON values for its file."""
    return {
        "command": command,
        "training_sha256": {str(run.path): _sha256(run.path) for run in training},
        "validation_sha256": {str(run.path): _sha256(run.path) for run in validation},
        "rows": fit.rows,
        "one_step_rmse_k": fit.one_step_rmse_k,
        "free_run_rmse_k": fit.free_run_rmse_k,
        "free_run_steps": FREE_RUN_STEPS,
        "orders_tried": [[score.p, score.q, score.rmse_k] for score in fit.scores],
        "numpy": np.__version__,
    }


def _sha256(path: Path | None) -> str:
    return "" if path is None else hashlib.sha256(read_file(path, TABLE)).hexdigest()


def _columns(run: RecordedRun, step_s: float, inputs: Sequence[str]) -> dict[str, Floats]:
    """Return the run at `step_s`; an input that is left out becomes 0."""
    place = str(run.path) if run.path is not None else "run"
    for key in ("time_s", "temp_air_c", *inputs):
        if key not in run.columns:
            raise DataError(f"{place}: {key}: the column is missing")
    time_s = run.columns["time_s"]
    period = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    if not 0.0 < period <= step_s * (1.0 + 1e-6):
        raise DataError(f"{place}: time_s: a period of {period:g} s does not fit a step of {step_s:g} s")
    wanted = {key: run.columns[key] for key in ("time_s", "temp_air_c", *inputs)}
    columns = resample(replace(run, columns=wanted), step_s).columns
    zeros = np.zeros(len(columns["time_s"]))
    return {"heater_duty": zeros, "fan_on": zeros, "temp_ambient_c": zeros, **columns}


def _refuse_constant(key: str, runs: Sequence[Mapping[str, Floats]]) -> None:
    values = np.concatenate([run[key] for run in runs])
    values = values[np.isfinite(values)]
    if values.size == 0:
        raise DataError(f"{key}: no value in the training runs")
    if np.ptp(values) < 1e-9:
        raise DataError(
            f"{key}: {values[0]:g} in every row of the training runs: its effect can't be known from them"
        )


def _fit_one(
    runs: Sequence[Mapping[str, Floats]],
    p: int,
    q: int,
    step_s: float,
    fan_input: FanInput | None,
    with_ambient: bool,
) -> tuple[Arx, int, float] | None:
    """Least squares over all runs, never across a border; the model, its rows and its one-step RMSE [K].

    None with too few rows for these orders.
    """
    blocks = [_regression(run, p, q, fan_input) for run in runs]
    regressors = np.concatenate([block[0] for block in blocks])
    target = np.concatenate([block[1] for block in blocks])
    used = np.array([True] * (p + q) + [fan_input is not None] * q + [with_ambient, True])
    whole = np.isfinite(regressors).all(axis=1) & np.isfinite(target)
    regressors, target = regressors[whole][:, used], target[whole]
    if len(target) < _ROWS_PER_COEFFICIENT * used.sum():
        return None
    # Scaled columns and a cut-off: lags that never differ share their effect instead of blowing up.
    scale = np.abs(regressors).max(axis=0) + 1e-12
    solution = np.linalg.lstsq(regressors / scale, target, rcond=1e-9)[0] / scale
    residual = regressors @ solution - target
    coefficients = np.zeros(len(used))
    coefficients[used] = solution
    model = Arx(
        temp=coefficients[:p],
        heater=coefficients[p : p + q],
        fan=coefficients[p + q : p + 2 * q],
        ambient=float(coefficients[-2]),
        intercept=float(coefficients[-1]),
        step_s=step_s,
        validity=_validity(runs, fan_input is not None, with_ambient),
        fan_input=fan_input or "on",
    )
    return model, len(target), float(np.sqrt((residual**2).mean()))


def _regression(
    run: Mapping[str, Floats], p: int, q: int, fan_input: FanInput | None
) -> tuple[Floats, Floats]:
    """Regressors [rows, p + 2 q + 2] and the next air temperature [rows] of one run."""
    temp = run["temp_air_c"]
    first, rows = max(p, q) - 1, len(temp) - 1
    if rows <= first:
        return np.empty((0, p + 2 * q + 2)), np.empty(0)

    def lags(values: Floats, count: int) -> list[Floats]:
        return [values[first - lag : rows - lag] for lag in range(count)]

    fan = run["fan_on"]
    if fan_input == "excess":
        fan = fan * (temp - run["temp_ambient_c"])
    columns = [*lags(temp, p), *lags(run["heater_duty"], q), *lags(fan, q)]
    columns += [run["temp_ambient_c"][first:rows], np.ones(rows - first)]
    return np.stack(columns, axis=1), temp[first + 1 :]


def _validity(
    runs: Sequence[Mapping[str, Floats]], with_fan: bool, with_ambient: bool
) -> dict[str, tuple[float, float]]:
    keys = ["temp_air_c", "heater_duty"] + ["fan_on"] * with_fan + ["temp_ambient_c"] * with_ambient
    values = {key: np.concatenate([run[key] for run in runs]) for key in keys}
    return {key: (float(np.nanmin(column)), float(np.nanmax(column))) for key, column in values.items()}
