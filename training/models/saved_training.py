"""Trainings as they were kept: each with its record, and its model ready to forecast."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from edge.core.errors import DataError
from edge.core.predictor import Predictor
from edge.models.arx_file import read_arx
from edge.models.pbm import read_twin
from training.models.ham import GuardedHamNet
from training.models.predictors import GuardedHamPredictor, eager
from training.models.registry import ARX_FILE, NETWORK_FILE, TWIN_FILE
from training.models.study import RESULT_FILE, SCENARIOS, Regime
from training.models.weights import load_network

UNGUARDED = "ham_unguarded"  # our hybrid with its guard off, nothing trained anew
PAPER = ("linear", "pbm", "lstm", "ham")
OURS = ("pbm_fitted", "linear_ambient", "twin", "lstm_increment", "ham_guarded")


@dataclass(frozen=True, slots=True)
class SavedTraining:
    """One training that was kept.

    record : its facts (settings, time, memory, versions); the errors in it are never read
    """

    model: str
    regime: Regime
    seed: int
    predictor: Predictor
    record: Mapping[str, Any]
    folder: Path


def read_trained(root: Path) -> list[SavedTraining]:
    """Every training under `root` that has its weights, by model in the order of the tables, regime and seed.

    Errors : DataError for one whose model doesn't load, or for a model or regime of which nothing is recorded
    """
    found = [
        _read(folder, model, regime)
        for model in (*PAPER, *OURS)
        for regime in SCENARIOS
        for folder in sorted((root / model / regime).glob("seed_*"), key=lambda path: path.name)
        if _has_weights(folder)
    ]
    for model in (*PAPER, *OURS):
        for regime in SCENARIOS:
            if not any((root / model / regime).glob(f"seed_*/{RESULT_FILE}")):
                raise DataError(f"{root / model / regime}: no training is kept here")
    return found


def without_weights(root: Path) -> list[Path]:
    """Return the folders of trainings that are recorded without their weights, to be trained anew.

    The repository has all but those of the LSTMs, of which it has the one that goes to a rig.
    """
    return [
        path.parent
        for path in sorted(root.glob(f"*/*/seed_*/{RESULT_FILE}"))
        if not _has_weights(path.parent)
    ]


def _has_weights(folder: Path) -> bool:
    return any((folder / name).exists() for name in (NETWORK_FILE, ARX_FILE, TWIN_FILE))


def remove_guard(kept: SavedTraining) -> SavedTraining:
    """Our hybrid trusted everywhere: margins without end, so that the correction never fades."""
    network, _ = load_network(kept.folder / NETWORK_FILE)
    if not isinstance(network, GuardedHamNet):
        raise DataError(f"{kept.folder}: {kept.model} has no guard to switch off")
    network.margin.copy_(torch.full_like(network.margin, torch.inf))
    return SavedTraining(
        UNGUARDED, kept.regime, kept.seed, GuardedHamPredictor(network), kept.record, kept.folder
    )


def _read(folder: Path, model: str, regime: Regime) -> SavedTraining:
    try:
        record = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{folder / RESULT_FILE}: cannot be read: {error}") from error
    for key, value in (("model", model), ("regime", regime)):
        if record.get(key) != value:
            raise DataError(f"{folder / RESULT_FILE}: {key}: {record.get(key)!r}, but it lies in {value}")
    return SavedTraining(model, regime, int(record["seed"]), _predictor(folder), record, folder)


def _predictor(folder: Path) -> Predictor:
    if (folder / NETWORK_FILE).exists():
        network, _ = load_network(folder / NETWORK_FILE)
        return eager(network)
    if (folder / ARX_FILE).exists():
        return read_arx(folder / ARX_FILE)
    return read_twin(folder / TWIN_FILE)
