"""Summary of many trainings' records: the table of errors, and the training to deploy."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.formats.table import Table
from training.models.study import RESULT_FILE, SCENARIOS, Regime

Record = Mapping[str, Any]


def records(out: Path) -> list[Record]:
    """Every record under `out`, in order of model, regime and seed. Errors: DataError where there is none."""
    found = [json.loads(path.read_text()) for path in sorted(out.glob(f"*/*/seed_*/{RESULT_FILE}"))]
    if not found:
        raise DataError(f"{out}: no {RESULT_FILE} of any training")
    return found


def table(found: Sequence[Record], names: Sequence[str]) -> Table:
    """Return the free-run MAE per model and scenario, and the mean of each regime; mean ± sd of seeds [K]."""
    heads = [head for numbers in SCENARIOS.values() for head in (*(str(n) for n in numbers), "mean")]
    rows = tuple(
        (name, *(cell for regime in SCENARIOS for cell in _cells(found, name, regime))) for name in names
    )
    return Table("", ("free-run MAE [K]", *heads), rows)


def best_seed(found: Sequence[Record], name: str, regime: Regime) -> int:
    """Return the seed with the lowest validation loss: test runs have no say in what is deployed.

    Errors : DataError where no such training is recorded
    """
    mine = [one for one in found if one["model"] == name and one["regime"] == regime]
    if not mine:
        raise DataError(f"no training of {name} for {regime} is recorded")
    return int(min(mine, key=lambda one: one["progress"].get("validation_loss", math.inf))["seed"])


def _cells(found: Sequence[Record], name: str, regime: Regime) -> Iterator[str]:
    mine = [one for one in found if one["model"] == name and one["regime"] == regime]
    maes = [
        [one["scenarios"][str(number)]["free_run"]["mae_k"] for number in SCENARIOS[regime]] for one in mine
    ]
    for column in zip(*maes, strict=True):
        yield spread(column)
    yield spread([float(np.mean(row)) for row in maes])


def spread(values: Sequence[float] | Floats) -> str:
    """Mean, and sd over the seeds where there are several; a dash for no value."""
    if not len(values):
        return "-"
    mean = f"{np.mean(values):.3f}"
    return mean if len(values) < 2 else f"{mean} ± {np.std(values, ddof=1):.3f}"
