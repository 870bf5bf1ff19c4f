"""One training of one model: what is fitted, how well it forecasts the test runs, and the record of both."""

import importlib.metadata
import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from edge.models.base import Predictor
from edge.run_file import Run
from training.datasets import data_sha256, test_run, training_runs
from training.peak_memory import peak_rss_mib, reset_peak
from training.rollout import errors, free_run, one_step

Regime = Literal["interpolation", "extrapolation"]
SCENARIOS: Mapping[Regime, tuple[int, ...]] = {"interpolation": (1, 2, 3), "extrapolation": (4, 5, 6)}
VERSIONS = ("greenhouse-twin", "numpy", "scipy", "torch")
RESULT_FILE = "result.json"


@dataclass(frozen=True, slots=True)
class Trained:
    """What a model's script hands back."""

    predictor: Predictor
    settings: Mapping[str, Any]
    progress: Mapping[str, Any]  # how the fit went: epochs, losses, orders
    save: Callable[[Path, Mapping[str, Any]], None]  # into a folder, with facts for the file


Train = Callable[[Sequence[Run], int, Path | None], Trained]  # training runs, seed, folder of the log


def study(name: str, train: Train, regime: Regime, seed: int, out: Path, log: Path | None) -> dict[str, Any]:
    """Train once, forecast every test run of the regime, save model and record; the record as JSON values.

    out : folder of this training; log : folder for TensorBoard, None for none
    """
    runs = training_runs(regime)
    reset_peak()
    began = time.perf_counter()
    trained = train(runs, seed, log)
    wall_s = time.perf_counter() - began
    record: dict[str, Any] = {
        "model": name,
        "regime": regime,
        "seed": seed,
        "data_sha256": data_sha256(runs),
        "settings": dict(trained.settings),
        "progress": dict(trained.progress),
        "wall_s": wall_s,
        "peak_rss_mib": peak_rss_mib(),
        "versions": versions(),
        "scenarios": {str(scenario): score(trained.predictor, scenario) for scenario in SCENARIOS[regime]},
    }
    out.mkdir(parents=True, exist_ok=True)
    trained.save(out, {key: record[key] for key in ("model", "regime", "seed", "data_sha256", "settings")})
    (out / RESULT_FILE).write_text(json.dumps(record, indent=1) + "\n")
    return record


def score(predictor: Predictor, scenario: int) -> dict[str, dict[str, float]]:
    """Errors of the free run and of single steps over the scenario's test run."""
    run = test_run(scenario)
    return {
        "free_run": asdict(errors(free_run(predictor, run), run)),
        "one_step": asdict(errors(one_step(predictor, run), run)),
    }


def versions() -> dict[str, str]:
    """Of what the figures depend on."""
    packages = {name: importlib.metadata.version(name) for name in VERSIONS}
    return {"python": platform.python_version(), **packages}


def folder(out: Path, name: str, regime: Regime, seed: int) -> Path:
    """Where one training is kept under `out`."""
    return out / name / regime / f"seed_{seed}"
