"""Regimes in which the twin disagrees, by their share of the squared error beyond their share of rows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.diagnosis_document import RegimeEntry
from edge.diagnosis.locate.residuals import Residuals
from edge.diagnosis.locate.rows import Rows, rows_of
from edge.twin.model import DAY_S

Floats = NDArray[np.float64]

Mask = NDArray[np.bool_]
JUST_SWITCHED = (1, 2, 5)  # rows
FIRST_ROWS = (10, 30)  # of a run
DUTY_EDGES = (0.0, 0.25, 0.5, 0.75, 1.0)
THRESHOLDS = (
    ("difference", "T - T_amb", "excess_k", "K"),
    ("room", "T_amb", "ambient", "degC"),
    ("rel_humidity", "the relative humidity", "rel_humidity", "%"),
)  # subject, name, column, unit
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)  # near which a continuous signal is split, at a round number
HOURS = 3  # of a part of the day
HOUR_S = 3600.0
STEEP_K_MIN = 0.05  # the air rises or falls, else it is steady


class Condition(NamedTuple):
    """about : the signal, one only in a pair; where : in words; mask : [R]"""

    about: str
    where: str
    mask: Mask


def conditions(rows: Rows) -> list[Condition]:
    """All single conditions that hold in some rows and not in all."""
    every = [*_actuators(rows), *_thresholds(rows), *_motion_and_times(rows)]
    return [item for item in every if item.mask.any() and not item.mask.all()]


def _actuators(rows: Rows) -> Iterator[Condition]:
    duty = rows.inputs["duty"]
    for name, key in (("heater", "duty"), ("fan", "fan"), ("light", "light")):
        if key in rows.inputs:
            yield Condition(name, f"the {name} is on", rows.inputs[key] > 0.0)
            yield Condition(name, f"the {name} is off", rows.inputs[key] == 0.0)
    for switch, ago in rows.switches.items():
        actuator, way = switch.split()
        for count in JUST_SWITCHED:
            first = "first row" if count == 1 else f"first {count} rows"
            yield Condition(actuator, f"the {actuator} has just gone {way} ({first})", ago < count)
    for low, high in pairwise(DUTY_EDGES):
        yield Condition("heater", f"the duty is {low:g} to {high:g}", (duty > low) & (duty <= high))
        if 0.0 < low < 1.0:
            yield Condition("heater", f"the duty is above {low:g}", duty > low)


def _thresholds(rows: Rows) -> Iterator[Condition]:
    for about, name, key, unit in THRESHOLDS:
        if key not in rows.inputs:
            continue
        values = rows.inputs[key]
        edges = _round_edges(values)
        for edge in edges:
            for sign, mask in ((">", values > edge), ("<", values < edge)):
                yield Condition(about, f"{name} {sign} {edge:g} {unit}", mask)
        for low, high in pairwise(edges):
            mask = (values >= low) & (values <= high)
            yield Condition(about, f"{name} is {low:g} to {high:g} {unit}", mask)


def _round_edges(values: Floats) -> list[float]:
    """Near the quantiles, in steps of 1, 2 or 5 times a power of ten that resolve a tenth of the range."""
    low, high = np.nanquantile(values, [0.02, 0.98])
    if not high > low:
        return []
    power = 10.0 ** np.floor(np.log10((high - low) / 8.0))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= (high - low) / 12.0)
    return sorted({float(round(q / step) * step) for q in np.nanquantile(values, QUANTILES)})


def _motion_and_times(rows: Rows) -> Iterator[Condition]:
    slope = rows.slope_k_min
    yield Condition("motion", "the air rises", slope > STEEP_K_MIN)
    yield Condition("motion", "the air falls", slope < -STEEP_K_MIN)
    yield Condition("motion", "the air is steady", np.abs(slope) <= STEEP_K_MIN)
    for count in FIRST_ROWS:
        yield Condition("begin", f"in the first {count} rows of a run", rows.row < count)
    if len(rows.names) > 1:
        for i, name in enumerate(rows.names):
            yield Condition("run", f"in {name}", rows.run == i)
    if "utc_s" not in rows.inputs:
        return
    utc_s = rows.inputs["utc_s"]
    hour = (utc_s % DAY_S) / HOUR_S
    for begin in range(0, 24, HOURS):
        where = f"between {begin:02d} and {begin + HOURS:02d} h UTC"
        yield Condition("hour", where, (hour >= begin) & (hour < begin + HOURS))
    day = ((utc_s - utc_s.min()) // DAY_S).astype(int)
    for count in np.unique(day):
        yield Condition("day", f"on day {count + 1}", day == count)
        if 0 < count < day.max():
            yield Condition("day", f"from day {count + 1} on", day >= count)


BLOCK_S = 1800.0  # errors further apart go their own ways
FEWEST_BLOCKS = 5  # with rows of the regime, and
FEWEST_ROWS = 15  # rows: fewer are not believed
DRAWS = 400  # of the bootstrap
SURE_SDS = 3.3  # one-sided 0.0005, for a few hundred regimes tried
PAIRED = 16  # best single conditions of which pairs are made
SIMPLER = 0.93  # what a pair's score counts beside a single condition's
ALIKE = 0.8  # share of the smaller one's error that two regimes have in common: one of them is enough
MOST = 6


def regimes(runs: Sequence[Residuals]) -> list[RegimeEntry]:
    """Return the regimes with clearly more of the squared error than of the rows, the strongest first.

    Confidence by a block bootstrap (Künsch 1989, Annals of Statistics 17). Too few rows have no regime.
    """
    rows = rows_of(runs) if runs else None
    if rows is None or not (rows.error_k**2).sum() > 0.0:
        return []
    blocks = _Blocks.of(rows)
    singles = blocks.believe(conditions(rows))
    first = sorted(singles, key=blocks.score, reverse=True)
    pairs = [
        Condition(f"{a.about} {b.about}", _join(a, b), a.mask & b.mask)
        for a, b in combinations([item for item in first[:PAIRED] if blocks.score(item) > 0.0], 2)
        if a.about != b.about and "run" not in (a.about, b.about)
    ]
    scored = [(blocks.score(item), item) for item in singles]
    scored += [(SIMPLER * blocks.score(item), item) for item in blocks.believe(pairs)]
    ranked = [item for score, item in sorted(scored, key=lambda s: -s[0]) if score > 0.0]
    return [blocks.regime(item) for item in _unlike(ranked, rows.error_k**2)]


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Rows in blocks that are drawn with replacement. begins : first row of each; counts : [DRAWS, blocks]"""

    rows: Rows
    squared: Floats
    begins: NDArray[np.intp]
    counts: Floats

    @classmethod
    def of(cls, rows: Rows) -> "_Blocks":
        length = max(5, round(BLOCK_S / rows.step_s))
        label = rows.run * (rows.row.max() + 1) + rows.row // length
        begins = np.flatnonzero(np.diff(label, prepend=label[0] - 1))
        draw = np.random.default_rng(0)  # the same data, the same answer
        counts = draw.multinomial(len(begins), np.full(len(begins), 1.0 / len(begins)), DRAWS)
        return cls(rows, rows.error_k**2, begins, counts.astype(np.float64))

    def believe(self, items: list[Condition]) -> list[Condition]:
        return [
            item
            for item in items
            if item.mask.sum() >= FEWEST_ROWS and (self._sums(item.mask) > 0.0).sum() >= FEWEST_BLOCKS
        ]

    def score(self, item: Condition) -> float:
        """How much more of the squared error than of the rows, at the least."""
        error, rows = self._shares(item.mask)
        return float((error[0] - rows[0]) - SURE_SDS * (error[1:] - rows[1:]).std())

    def regime(self, item: Condition) -> RegimeEntry:
        error, share = self._shares(item.mask)
        low, high = np.quantile(error[1:], [0.025, 0.975])
        held = self._draw(item.mask)
        mean_w = self._draw(np.where(item.mask, self.rows.heat_w, 0.0)) / np.maximum(held, 1.0)
        return {
            "where": item.where,
            "share_of_squared_error": float(error[0]),
            "heat_w": float(mean_w[0]),
            "heat_w_se": float(mean_w[1:][held[1:] > 0.0].std()),
            "share_low": max(float(low), 0.0),  # rounding may leave it below
            "share_high": float(high),
            "share_of_rows": float(share[0]),
            "rmse_k": float(np.sqrt(self.squared[item.mask].mean())),
        }

    def _shares(self, mask: Mask) -> tuple[Floats, Floats]:
        """Return the shares of squared error and rows, as recorded, then resampled, [1 + DRAWS] each."""
        total, every = self._draw(self.squared), self._draw(np.ones_like(self.squared))
        return self._draw(np.where(mask, self.squared, 0.0)) / total, self._draw(mask) / every

    def _draw(self, values: Floats | Mask) -> Floats:
        sums = self._sums(values)
        return np.concatenate([[sums.sum()], self.counts @ sums])

    def _sums(self, values: Floats | Mask) -> Floats:
        sums: Floats = np.add.reduceat(values.astype(np.float64), self.begins)
        return sums


def _join(a: Condition, b: Condition) -> str:
    """Join two conditions in words, inputs before temperatures."""
    first, second = sorted((a, b), key=lambda item: (item.where.startswith(("in ", "T")), item.where))
    return f"{first.where} and {second.where}"


def _unlike(ranked: list[Condition], squared: Floats) -> list[Condition]:
    """Return the first of each group of similar conditions."""
    chosen: list[Condition] = []
    for item in ranked:
        shares = [
            squared[item.mask & other.mask].sum()
            / max(min(squared[item.mask].sum(), squared[other.mask].sum()), 1e-300)
            for other in chosen
        ]
        if len(chosen) < MOST and all(share < ALIKE for share in shares):
            chosen.append(item)
    return chosen
