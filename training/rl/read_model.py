"""The models of `greenhouse-train rl --model`: kept trainings by name, or a twin by its file."""

import hashlib
from pathlib import Path

import numpy as np

from edge.core.errors import DataError
from edge.lab.box import draw_values
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile, read_twin_file
from training.models.ham import GuardedHamNet
from training.models.registry import NETWORK_FILE, TWIN_FILE
from training.models.study import Regime
from training.models.summary import best_seed, records
from training.models.weights import load_network
from training.models.window_network import LstmNet
from training.rl.models import HamModel, LstmModel, StepModel, TwinModel

TRAINED = Path("training/results/trained")
REGIME: Regime = "interpolation"
KEPT = {"ham": "ham_guarded", "lstm": "lstm", "pbm": "twin"}  # name here -> whose kept training it is


def read_model(name: str, variants: int = 1, seed: int = 0, trained: Path = TRAINED) -> StepModel:
    """Read the model `name`, a key of KEPT or a twin file; of saved
    trainings the one with the best validation.

    variants : beside the twin as fitted, how many with parameters drawn within their confidence intervals
    Errors : DataError for a file that is none, and for variants of a model that has no twin
    """
    if name not in KEPT:
        return TwinModel(draw_twins(read_twin_file(Path(name)), variants, seed), Path(name).stem)
    folder = kept_folder(name, trained)
    if name == "lstm" and variants > 1:
        raise DataError(f"{name}: has no physical parameters to draw at random")
    if name == "lstm":
        return _lstm(folder / NETWORK_FILE)
    physics = TwinModel(draw_twins(read_twin_file(folder / TWIN_FILE), variants, seed), name)
    return physics if name == "pbm" else ham_over(physics, folder / NETWORK_FILE)


def kept_folder(name: str, trained: Path = TRAINED) -> Path:
    """Return the saved training of a key of KEPT with the best validation. Errors: DataError"""
    kept = KEPT[name]
    return trained / kept / REGIME / f"seed_{best_seed(records(trained), kept, REGIME)}"


def ham_over(physics: TwinModel, path: Path) -> HamModel:
    """Return the hybrid of the network in `path` over that physics. Errors: DataError for another network"""
    network, _ = load_network(path)
    if not isinstance(network, GuardedHamNet):
        raise DataError(f"{path}: {type(network).__name__} is no guarded hybrid")
    return HamModel(network, physics, _sha256(path))


def _lstm(path: Path) -> LstmModel:
    network, _ = load_network(path)
    if not isinstance(network, LstmNet):
        raise DataError(f"{path}: {type(network).__name__} is no LSTM")
    return LstmModel(network, _sha256(path))


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def draw_twins(file: TwinFile, variants: int, seed: int) -> list[BoxTwin]:
    """Return the twin of a file, then others with fitted values uniform between their `low` and `high`.

    Errors : DataError where a value is still to be fitted, or there is nothing to draw
    """
    if waiting := file.to_fit():
        raise DataError(f"{'.'.join(waiting[0])}: is still to be fitted")
    rng = np.random.default_rng(seed)
    return [file.twin(), *(draw_values(file, rng).twin() for _ in range(variants - 1))]
