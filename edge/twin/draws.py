"""Twins drawn from the intervals of a twin file, and from the correlations that a fit has left there."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.effects.library import acting_effects
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import SDS_95, Value

Floats = NDArray[np.float64]
CORRELATION = "correlation"  # key of the provenance
DIGITS = 3  # of a correlation in a file
SEED = 1  # the same question gets the same answer


@dataclass(frozen=True, slots=True)
class Spread:
    """The distribution of a value: normal about `middle`, of its logarithm where `log`."""

    middle: float
    sd: float
    log: bool

    @classmethod
    def of(cls, value: Value) -> "Spread | None":
        """Return the distribution that a file's value stands for; None for an exact one."""
        if value.rel_sd is not None:
            return cls(value.value, abs(value.rel_sd * value.value), False)
        if value.low is None or value.high is None or value.low == value.high:
            return None
        plain = (value.value - value.low, value.high - value.value)
        if value.low <= 0.0 or value.value <= 0.0:
            return cls(value.value, max(plain) / SDS_95, False)
        ratios = (math.log(value.value / value.low), math.log(value.high / value.value))
        # A fit gives intervals that are even in the value or in its logarithm, cut at the value's bounds.
        if abs(ratios[0] - ratios[1]) / max(ratios) < abs(plain[0] - plain[1]) / max(plain):
            return cls(math.log(value.value), max(ratios) / SDS_95, True)
        return cls(value.value, max(plain) / SDS_95, False)

    def at(self, sds: float) -> float:
        """Return the value so many standard deviations from the middle."""
        moved = self.middle + sds * self.sd
        return math.exp(moved) if self.log else moved


def correlation_document(places: Sequence[Place], covariance: Floats) -> dict[str, Any]:
    """Return the correlations of fitted values as a provenance holds them. covariance : [p, p] or larger"""
    size = len(places)
    own = covariance[:size, :size]
    sds = np.sqrt(np.maximum(np.diag(own), 1e-300))
    rows = np.clip(own / np.outer(sds, sds), -1.0, 1.0).round(DIGITS)
    return {
        "values": [".".join(place) for place in places],
        "rows": [[float(item) for item in row[: i + 1]] for i, row in enumerate(rows)],
    }


def uncertain(file: TwinFile) -> dict[Place, Spread]:
    """Return the distributions of the values that act and are not exact, by place."""
    acting = set(acting_effects(file.effects))
    found = {place: Spread.of(value) for place, value in file.values().items()}
    return {
        place: spread
        for place, spread in found.items()
        if spread is not None and (place[0] == "geometry" or place[1] in acting)
    }


def drawn_twins(file: TwinFile, count: int) -> list[TwinFile]:
    """Return twins whose values are drawn from their intervals, every part of each interval equally often.

    Errors : DataError for a provenance whose correlations cannot be understood
    """
    spreads = uncertain(file)
    if not spreads:
        return [file] * count
    normal = even_normals(count, len(spreads)) @ _root(correlations(file, tuple(spreads))).T
    return [
        file.with_values(
            {
                place: Value(_possible(file, place, spread.at(float(sds))))
                for (place, spread), sds in zip(spreads.items(), row, strict=True)
            }
        )
        for row in normal
    ]


def correlations(file: TwinFile, places: Sequence[Place]) -> Floats:
    """Return the matrix of the places, independent where the file says nothing. Errors: DataError"""
    found: Floats = np.eye(len(places))
    document = file.provenance.get(CORRELATION)
    if document is None:
        return found
    try:
        names, rows = list(document["values"]), [[float(item) for item in row] for row in document["rows"]]
        if [len(row) for row in rows] != list(range(1, len(names) + 1)):
            raise ValueError
    except (TypeError, KeyError, ValueError):
        raise DataError(f"provenance.{CORRELATION}: is no triangle of numbers with names") from None
    at = {tuple(str(name).split(".")): i for i, name in enumerate(names)}
    for i, one in enumerate(places):
        for j, other in enumerate(places[:i]):
            if one in at and other in at:
                first, second = max(at[one], at[other]), min(at[one], at[other])
                found[i, j] = found[j, i] = min(max(rows[first][second], -1.0), 1.0)
    return found


def _root(matrix: Floats) -> Floats:
    """Return R with R R' = matrix; what rounding has made negative counts as 0."""
    values, vectors = np.linalg.eigh(matrix)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root / np.sqrt((root**2).sum(axis=1))[:, None])


def even_normals(count: int, size: int) -> Floats:
    """Return a Latin hypercube of standard normals [count, size] (McKay et al. 1979, Technometrics 21)."""
    random, ppf = np.random.default_rng(SEED), NormalDist().inv_cdf
    levels = np.array([ppf((i + 0.5) / count) for i in range(count)])
    return np.stack([random.permutation(levels) for _ in range(size)], axis=1)


def _possible(file: TwinFile, place: Place, value: float) -> float:
    """Return the value inside the range that is physically possible."""
    if place[0] == "geometry":
        least: Mapping[Place, Value] = file.values()
        return max(value, 0.01 * least[place].value)
    parameter = file.possible(place)
    return min(max(value, parameter.low), parameter.high)
