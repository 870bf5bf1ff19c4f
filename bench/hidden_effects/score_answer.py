"""A diagnosis as the scorer reads it: only what the contract says, and nothing of it believed."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError

Floats = NDArray[np.float64]
VERDICTS = ("named", "nothing_missing", "unknown")
MOST_ALTERNATIVES = 5  # more is no answer


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect of an answer. intervals : low and high by parameter, NaN where there is none."""

    name: str
    alternatives: tuple[str, ...]
    intervals: Mapping[str, tuple[float, float]]

    @property
    def hedges(self) -> bool:
        return len(set(self.alternatives) - {self.name}) > MOST_ALTERNATIVES


@dataclass(frozen=True, slots=True)
class DiagnosisAnswer:
    """A diagnosis. before, after : predictions of test runs by file name, NaN where there is none [°C]."""

    verdict: str
    effects: tuple[NamedEffect, ...]
    depends_on: tuple[str, ...]
    before: Mapping[str, Floats]
    after: Mapping[str, Floats]


def read_answer(path: Path) -> DiagnosisAnswer:
    """Read the diagnosis in a file. Errors: DataError naming the file, if it is missing or invalid"""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return answer(document)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: no diagnosis: {error!r}") from error


def answer(document: Mapping[str, Any]) -> DiagnosisAnswer:
    """Return the answer of a document. Errors: ValueError, KeyError,
    TypeError, AttributeError for an invalid one
    """
    verdict = document["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"verdict {verdict!r} is none of {VERDICTS}")
    effects = document["effects"] if verdict == "named" else []  # others have no say
    if verdict == "named" and not effects:
        raise ValueError("the verdict is 'named', but no effect is")
    predictions = document["predictions"]
    return DiagnosisAnswer(
        verdict,
        tuple(_named_effect(item) for item in effects),
        tuple(document["depends_on"]),
        {run: _series(own["before"]) for run, own in predictions.items()},
        {run: _series(own["after"]) for run, own in predictions.items()},
    )


def _named_effect(document: Mapping[str, Any]) -> NamedEffect:
    intervals = {
        key: (_number(item.get("low")), _number(item.get("high")))
        for key, item in document["parameters"].items()
    }
    return NamedEffect(document["name"], tuple(document["alternatives"]), intervals)


def _series(values: list[float | None]) -> Floats:
    return np.array([_number(item) for item in values], dtype=np.float64)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
