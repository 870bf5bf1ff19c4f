"""Costs of a model: time to train, memory to load and run, time to forecast. Measured, never compared."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, Final

import numpy as np
from pympler import asizeof

from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file
from training.export.network_export import export_study
from training.models.registry import ARX_FILE, NETWORK_FILE, TWIN_FILE
from training.models.rollout import START_ROWS
from training.models.saved_training import SavedTraining
from training.models.summary import best_seed
from training.models.weights import load_network

REGIME: Final = "interpolation"
KIB = 1024


@dataclass(frozen=True, slots=True)
class ModelCost:
    """Costs of one model, as deployed: the seed that validates best, trained on all runs.

    train_s, train_peak_mib : mean over the seeds; the peak is the whole process's, torch in it
    weights_kib : of the tensors, which asizeof doesn't see
    loaded_kib : pympler's asizeof of the predictor, as in the paper, and the tensors
    running_kib : the same with the arguments and the result of a free run over a test run
    edge_before_mib .. edge_batch_ms : see `training.evaluate.edge_process`
    """

    model: str
    train_s: float
    train_peak_mib: float
    weights_kib: float
    loaded_kib: float
    running_kib: float
    edge_before_mib: float
    edge_loaded_mib: float
    edge_ran_mib: float
    edge_load_s: float
    edge_one_ms: float
    edge_batch_ms: float


def costs(trainings: Sequence[SavedTraining], rows: int = 213) -> list[ModelCost]:
    """One per model; rows : of the free run that counts as running."""
    models = list(dict.fromkeys(kept.model for kept in trainings))
    with tempfile.TemporaryDirectory() as folder:
        return [_cost(model, trainings, rows, Path(folder)) for model in models]


def _cost(model: str, trainings: Sequence[SavedTraining], rows: int, folder: Path) -> ModelCost:
    mine = [kept for kept in trainings if kept.model == model and kept.regime == REGIME]
    seed = best_seed([kept.record for kept in mine], model, REGIME)
    kept = next(one for one in mine if one.seed == seed)
    weights = _weights_bytes(kept.folder)
    edge = _edge(kept, folder)
    return ModelCost(
        model,
        train_s=fmean(one.record["wall_s"] for one in mine),
        train_peak_mib=fmean(one.record["peak_rss_mib"] for one in mine),
        weights_kib=weights / KIB,
        loaded_kib=(asizeof.asizeof(kept.predictor) + weights) / KIB,
        running_kib=(asizeof.asizeof(_running(kept, rows)) + weights) / KIB,
        **{f"edge_{key}": value for key, value in edge.items()},
    )


def _weights_bytes(folder: Path) -> int:
    if not (folder / NETWORK_FILE).exists():
        return 0
    network, _ = load_network(folder / NETWORK_FILE)
    return sum(tensor.nbytes for tensor in network.state_dict().values())


def _running(kept: SavedTraining, rows: int) -> tuple[Any, ...]:
    """Return the predictor with its inputs for a free run, and its outputs."""
    columns = {"temp_air": 27.0, "temp_ambient": 22.0, "heater_duty": 0.4, "fan_on": 0.0}
    history = {name: np.full(START_ROWS, value) for name, value in columns.items()}
    ahead = {name: np.full(rows - START_ROWS, value) for name, value in columns.items()}
    controls = np.stack([ahead["heater_duty"], ahead["fan_on"]], axis=-1)[None]
    return kept.predictor, history, controls, ahead, kept.predictor.rollout(history, controls, ahead)


def _edge(kept: SavedTraining, folder: Path) -> dict[str, float]:
    """Figures of `training.evaluate.edge_process`; networks go there as ONNX files."""
    words = [*_edge_model(kept, folder)]
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "training.evaluate.edge_process", *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | one_thread)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def _edge_model(kept: SavedTraining, folder: Path) -> tuple[str, ...]:
    """Kind, file and, for a hybrid, the hash of its twin."""
    if (kept.folder / ARX_FILE).exists():
        return "arx", str(kept.folder / ARX_FILE)
    if not (kept.folder / NETWORK_FILE).exists():
        return "pbm", str(kept.folder / TWIN_FILE)
    file = folder / f"{kept.model}.onnx"
    export_study(kept.folder, file)
    if kept.model.startswith("lstm"):
        return "lstm", str(file)
    own = kept.folder / TWIN_FILE
    return "ham", str(file), (read_twin_file(own).twin() if own.exists() else BoxTwin()).sha256
