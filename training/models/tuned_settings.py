"""Settings of the networks: the trials that every network gets, and the trial that validated best.

Every network gets the same settings, the paper's first. `training.evaluate.tune_networks` scores them.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.errors import DataError
from training.models.window_network import WindowSettings

FILE = "tuning.json"
BOX_DATA = "heated_box"  # the data that are not a regime: the real box
ANY_ROOM_C = 20.0  # no network of a window sees the room, but its runs need a column
LEARNING_RATES = (3e-4, 1e-2)  # drawn evenly by their logarithm
BATCH_SIZES = (40, 160)
WIDTHS = (16, 32, 64)
DROPOUTS = (0.0, 0.1, 0.2)


@dataclass(frozen=True, slots=True)
class NetworkTrial:
    """One trial of one network, scored on validation parts alone.

    network : a key of `networks.NETWORKS`; data : a regime, or "heated_box"
    seed : of the training; data_sha256 : of the runs, training and validation parts together
    validation_mae_k : mean free-run MAE over the validation parts [K]; None where it is not a number
    """

    network: str
    data: str
    trial: int
    settings: WindowSettings
    seed: int
    data_sha256: str
    command: str
    validation_mae_k: float | None
    epochs: int
    wall_s: float


def trial_settings(count: int, seed: int) -> list[WindowSettings]:
    """Return the paper's settings and `count - 1` drawn ones, half of them of increments."""
    draw = np.random.default_rng(seed)
    low, high = np.log(LEARNING_RATES)
    paper = WindowSettings()
    drawn = [
        replace(
            paper,
            learning_rate=float(f"{np.exp(draw.uniform(low, high)):.2g}"),
            batch_size=int(draw.choice(BATCH_SIZES)),
            hidden=int(draw.choice(WIDTHS)),
            dropout=float(draw.choice(DROPOUTS)),
            predicts_increment=number % 2 == 0,
        )
        for number in range(count - 1)
    ]
    return [paper, *drawn][:count]


def read_trials(folder: Path) -> list[NetworkTrial]:
    """Return the trials of a results folder, none where there is no file. Errors: DataError"""
    path = folder / FILE
    if not path.exists():
        return []
    try:
        rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        return [NetworkTrial(**{**row, "settings": WindowSettings(**row["settings"])}) for row in rows]
    except (ValueError, TypeError, KeyError) as error:
        raise DataError(f"{path}: not a list of trials: {error}") from error


def best_trial(trials: Sequence[NetworkTrial], network: str, data: str, data_sha256: str) -> NetworkTrial:
    """Return the trial with the least validation error.

    Errors : DataError where the network has no trial on these runs, or the others there had more or fewer
    """
    here = [one for one in trials if one.data == data and one.data_sha256 == data_sha256]
    mine = [one for one in here if one.network == network]
    again = f"`greenhouse-train tune-networks --networks {network} --data {data}`"
    if not mine:
        raise DataError(f"{network}: no trial on {data} as it is now: {again}")
    numbers = {name: {t.trial for t in here if t.network == name} for name in {t.network for t in here}}
    if unequal := sorted(name for name, found in numbers.items() if found != numbers[network]):
        raise DataError(f"{network}: its trials on {data} are not those of {', '.join(unequal)}: {again}")
    finite = [one for one in mine if one.validation_mae_k is not None]
    if not finite:
        raise DataError(f"{network}: no trial on {data} gave a finite forecast")
    return min(finite, key=lambda one: one.validation_mae_k or 0.0)
