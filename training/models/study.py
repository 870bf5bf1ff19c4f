"""One training of one model: what is fitted, how well it forecasts the test runs, and the record of both."""

import importlib.metadata
import json
import platform
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edge.core.predictor import Predictor
from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import RecordedRun
from training.data.datasets import data_sha256, test_run, training_runs
from training.data.pairs import INPUTS, split_all, stretches
from training.models.rollout import errors, free_run, one_step

Regime = Literal["interpolation", "extrapolation"]
SCENARIOS: Mapping[Regime, tuple[int, ...]] = {"interpolation": (1, 2, 3), "extrapolation": (4, 5, 6)}
VERSIONS = ("greenhouse-twin", "numpy", "scipy", "torch")
RESULT_FILE = "result.json"
FACTS = (  # of the record, kept with a model
    "model", "regime", "seed", "command", "data_sha256", "validity", "settings", "versions", "wall_s"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """The result of a model's script."""

    predictor: Predictor
    settings: Mapping[str, Any]
    progress: Mapping[str, Any]  # how the fit went: epochs, losses, orders
    save: Callable[[Path, Mapping[str, Any]], None]  # into a folder, with facts for the file


Train = Callable[
    [Sequence[RecordedRun], int, Path | None], TrainedModel
]  # training runs, seed, folder of the log


@dataclass(frozen=True, slots=True)
class TrainingJob:
    """One training to be done."""

    name: str  # of the model, as in `training.models.registry.MODELS`
    regime: Regime
    seed: int
    command: str  # that does it again

    def folder(self, root: Path) -> Path:
        """Return the training's folder under `root`."""
        return root / self.name / self.regime / f"seed_{self.seed}"


def study(job: TrainingJob, train: Train, out: Path, log: Path | None) -> dict[str, Any]:
    """Train once, forecast every test run of the regime, save model and record; the record as JSON values.

    out, log : folders under which the job has its own, for its files and for TensorBoard (None for no log)
    """
    runs = training_runs(job.regime)
    kept = job.folder(out)
    # The peak of this training, not of an earlier one in the same worker.
    reset_peak()
    began = time.perf_counter()
    trained = train(runs, job.seed, None if log is None else job.folder(log))
    wall_s = time.perf_counter() - began
    record: dict[str, Any] = {
        "model": job.name,
        "regime": job.regime,
        "seed": job.seed,
        "command": job.command,
        "data_sha256": data_sha256(runs),
        "validity": validity(runs),
        "settings": dict(trained.settings),
        "progress": dict(trained.progress),
        "wall_s": wall_s,
        "peak_rss_mib": peak_rss_mib(),
        "versions": versions(),
        "scenarios": {str(number): score(trained.predictor, number) for number in SCENARIOS[job.regime]},
    }
    kept.mkdir(parents=True, exist_ok=True)
    trained.save(kept, {key: record[key] for key in FACTS})
    write_atomically(kept / RESULT_FILE, json.dumps(record, indent=1) + "\n")
    return record


def score(predictor: Predictor, scenario: int) -> dict[str, dict[str, float]]:
    """Errors of the free run and of single steps over the scenario's test run."""
    run = test_run(scenario)
    return {
        "free_run": asdict(errors(free_run(predictor, run), run)),
        "one_step": asdict(errors(one_step(predictor, run), run)),
    }


def validity(runs: Sequence[RecordedRun]) -> dict[str, list[float]]:
    """Lowest and highest value of each input in the training parts, by border key."""
    columns = np.concatenate([np.stack(stretch) for stretch in stretches(split_all(runs).train)], axis=1)
    return {key: [float(row.min()), float(row.max())] for key, row in zip(INPUTS, columns, strict=True)}


def versions() -> dict[str, str]:
    """Return the versions that the figures depend on."""
    packages = {name: importlib.metadata.version(name) for name in VERSIONS}
    return {"python": platform.python_version(), **packages}


_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")
_RESET_PEAK = "5"  # man 5 proc, clear_refs


def reset_peak() -> None:
    """Count from now on, where the system can (Linux); elsewhere the peak is that of the whole process."""
    if _CLEAR.exists():
        _CLEAR.write_text(_RESET_PEAK)


def peak_rss_mib() -> float:
    """Largest resident memory of this process [MiB]."""
    if _STATUS.exists():
        lines = _STATUS.read_text().splitlines()
        found = next((line for line in lines if line.startswith("VmHWM:")), None)
        if found is not None:
            return int(found.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
