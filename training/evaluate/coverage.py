"""Calibrate prediction intervals, measure their coverage: `python -m training.evaluate.coverage [FOLDER]`.

FOLDER holds the models as a bundle does (arx.json, twin.yaml, lstm.onnx, ham.onnx, as many as there are) and
gets intervals.json; without it the packaged ARX model and the paper's PBM are measured. 100 runs calibrate,
100 others test, 30 that are hotter than any training run show what an extrapolation does to the claim.
"""

import argparse
import json
import pickle
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import Settings
from edge.core.errors import DataError
from edge.core.messages import Command, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.core.predictor import Predictor
from edge.core.sweep import add_arguments, sweep
from edge.forecasts.conformal import CLAIMED, Interval, Intervals, half_width, track, write_intervals
from edge.forecasts.scorer import PERSISTENCE, Scorer
from edge.formats.run_file import RecordedRun
from edge.formats.table import Table
from edge.models.arx_file import read_arx
from edge.models.onnx_predictor import read_ham, read_lstm
from edge.models.pbm import Pbm, read_twin
from edge.tick.estimator import Estimator
from training.evaluate import fresh_runs

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


RESULTS = Path(__file__).parents[1] / "results"
INTERVALS = "intervals.json"
REGIME = "interpolation"
SEEN = (0.88, 0.92)  # of a claim of 0.9
TRAINED_TO_C = 36.9  # hottest reading of the training runs


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """One predictor at one horizon; shares of the measurements that were inside."""

    predictor: str
    horizon_min: int
    half_width_k: float
    mae_k: float  # in interpolation
    interpolation: float
    interpolation_adaptive: float  # with the width following the errors from run to run
    extrapolation: float
    extrapolation_hot: float  # of the measurements above TRAINED_TO_C alone
    extrapolation_adaptive: float


def main(words: Sequence[str] | None = None) -> None:
    """Make or read the runs, calibrate, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="a bundle's files")
    parser.add_argument("--runs", type=Path, default=Path("out/coverage"), help="where the runs are kept")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where coverage.txt and .json go")
    add_arguments(parser)
    given = parser.parse_args(words)
    place = (given.workers, given.dask)
    load = partial(predictors_in, given.folder)
    predictors = load()
    runs = {kind: fresh_runs.runs(kind, given.runs, None, *place) for kind in fresh_runs.COUNTS}
    # Calibrated and measured on different runs: a width is always right where it was taken from.
    intervals = calibrate(runs["calibration"], load, *place)
    if given.folder is not None:
        write_intervals(intervals, given.folder / INTERVALS)
    rows = measure(
        intervals,
        errors_of(runs["interpolation"], load, *place),
        errors_of(runs["extrapolation"], load, *place),
    )
    text = table(rows, predictors)
    print(text, end="")
    given.results.mkdir(parents=True, exist_ok=True)
    (given.results / "coverage.txt").write_text(text, encoding="utf-8")
    document = {
        "claimed": CLAIMED,
        "versions": {name: predictor.version for name, predictor in predictors.items()},
        "runs": {kind: len(found) for kind, found in runs.items()},
        "rows": [asdict(row) for row in rows],
    }
    (given.results / "coverage.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def calibrate(
    runs: Sequence[RecordedRun], load: Load, workers: int = 2, dask: str | None = None
) -> Intervals:
    """Half widths per predictor and horizon. Errors: DataError for a test run: it calibrates nothing."""
    for run in runs:
        if run.facts.get("role") != "calibrate":
            raise DataError(f"{run.path}: role: {run.facts.get('role')!r} is not 'calibrate'")
    predictors, errors = load(), errors_of(runs, load, workers, dask)
    widths = {key: half_width([rows[:, 0] for rows in by_run]) for key, by_run in errors.items()}
    rows = tuple(
        Interval(name, predictors[name].version, horizon, round(width, 4), len(runs), REGIME)
        for (name, horizon), width in widths.items()
        if name != PERSISTENCE and np.isfinite(width)
    )
    seeds = [run.facts["seed"] for run in runs]
    return Intervals(
        rows, {"command": "python -m training.evaluate.coverage", "seeds": f"{seeds[0]}..{seeds[-1]}"}
    )


def measure(intervals: Intervals, interpolation: Errors, extrapolation: Errors) -> list[CoverageRow]:
    """Return the coverage of the intervals in both regimes, by predictor and horizon."""
    rows = []
    for interval in intervals.rows:
        key, width = (interval.predictor, interval.horizon_min), interval.half_width_k
        inside, outside = (np.concatenate(errors[key]) for errors in (interpolation, extrapolation))
        hot = outside[outside[:, 1] > TRAINED_TO_C]
        rows.append(
            CoverageRow(
                *key,
                width,
                float(np.abs(inside[:, 0]).mean()),
                _held_share(inside, width),
                _held_adaptive(inside, width),
                _held_share(outside, width),
                _held_share(hot, width),
                _held_adaptive(outside, width),
            )
        )
    return rows


def table(rows: Sequence[CoverageRow], predictors: Mapping[str, Predictor]) -> str:
    """Return the figures as text."""
    heads = ("model", "min", "+- [K]", "MAE [K]", "seen", "following", "extrapolation: seen",
             "above 36.9 degC", "following")  # fmt: skip
    cells = tuple(
        (
            row.predictor,
            str(row.horizon_min),
            f"{row.half_width_k:.2f}",
            f"{row.mae_k:.3f}",
            f"{_mark(row)}{row.interpolation:.1%}",
            f"{row.interpolation_adaptive:.1%}",
            f"{row.extrapolation:.1%}",
            f"{row.extrapolation_hot:.1%}",
            f"{row.extrapolation_adaptive:.1%}",
        )
        for row in rows
    )
    # Of twenty rows of a hundred runs one or two lie outside by chance: they are marked, not refused.
    low, high = SEEN
    lines = [
        f"Prediction intervals: {CLAIMED:.0%} claimed, seen on runs that neither trained nor calibrated",
        *(f"{name} {predictor.version}" for name, predictor in predictors.items()),
        "",
        *Table("", heads, cells, f"! not {low:.0%}..{high:.0%}").text(),
    ]
    keys = ("interpolation", "interpolation_adaptive", "extrapolation", "extrapolation_adaptive")
    means = [np.mean([getattr(row, key) for row in rows]) for key in keys]
    lines += [
        f"in all: interpolation {means[0]:.1%} ({means[1]:.1%} following), "
        f"extrapolation {means[2]:.1%} ({means[3]:.1%} following)",
        "following: the width follows the errors, as on the rig (edge/forecasts/conformal.py)",
    ]
    return "\n".join(lines) + "\n"


def _mark(row: CoverageRow) -> str:
    low, high = SEEN
    return "" if low <= row.interpolation <= high else "! "


def _held_share(errors: Floats, width: float) -> float:
    return float((np.abs(errors[:, 0]) <= width).mean()) if len(errors) else float("nan")


def _held_adaptive(errors: Floats, width: float) -> float:
    held = 0
    for residual in errors[:, 0].tolist():
        held += abs(residual) <= width
        width = track(width, residual)
    return held / len(errors) if len(errors) else float("nan")


if __name__ == "__main__":
    main()
