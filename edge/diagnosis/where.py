"""Disagreement of the twin as given: conditions that hold more of the squared error than of the rows.

The errors are those of its fitted free runs. Confidence comes from a block bootstrap (Künsch 1989, Annals of
Statistics 17). Also the doors that were found, and innovations for the report's plots.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.diagnosis_document import EventEntry, RegimeEntry
from edge.diagnosis.locate.heat_filter import filter_heat, likeliest, steps_of, white
from edge.twin.linearise import EnsembleRun, LinearSteps, linearise, responses
from edge.twin.model import DAY_S, BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
JUST_ROWS = 5  # after a switch
FIRST_ROWS = 30  # of a run
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)  # at which a signal is split
HOURS = 3  # of a part of the day
BLOCK_S = 1800.0  # errors further apart are independent
FEWEST_BLOCKS = 5  # with rows of a condition, and
FEWEST_ROWS = 15  # rows: fewer are not believed
DRAWS = 400  # of the bootstrap
SURE_SDS = 3.3  # one-sided 0.0005, for some hundred conditions tried
PAIRED = 16  # best conditions of which pairs are made
SIMPLER = 0.93  # what a pair's score counts against a single condition's
ALIKE = 0.8  # share of the smaller one's error that two conditions have in common: one of them is enough
MOST = 6


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """Places of the disagreement, in the form of diagnosis.json.

    innovations : of each run in standard deviations, a value a step, NaN where nothing was measured; empty
        where the twin is too far off
    """

    regimes: list[RegimeEntry] = field(default_factory=list)
    events: list[EventEntry] = field(default_factory=list)
    innovations: Mapping[str, Floats] = field(default_factory=dict)


def locate(found: Diagnosis) -> Location:
    """Return where the twin as given disagrees with the training runs."""
    known, fit = found.inputs, found.before.fit
    runs, twin = known.with_rooms(fit.starts), fit.file.twin()
    events: list[EventEntry] = [
        {"run": door.run, "from_s": door.from_s, "to_s": door.to_s, "kind": "door", "heat_w": door.heat_w}
        for door in found.doors
    ]
    try:
        own = dict(zip(known.names, innovations(twin, runs, known.noise_k), strict=True))
        return Location(regimes(twin, runs, known.names, fit.errors), events, own)
    except (DataError, np.linalg.LinAlgError):
        return Location(events=events)  # a twin that is so far off that its filter has no sense


def innovations(twin: BoxTwin, runs: RunBatch, sensor_k: float) -> Floats:
    """Return the errors of a filter that believes the twin but for white noise, in sds, [B, N]."""
    steps = steps_of(twin, runs, sensor_k)
    steps = replace(steps, start_sd=np.append(steps.start_sd[:-2], [0.0, 0.0]))
    return white(filter_heat(steps, sensor_k, likeliest(steps, sensor_k, wander=(0.0,))))


class Condition(NamedTuple):
    """A condition in words, and where it holds, [B, N]."""

    where: str
    mask: Mask


def conditions(runs: RunBatch, names: Sequence[str], step_s: float) -> Iterator[Condition]:
    """Yield all single conditions."""
    inputs = {"heater": runs.duty, "fan": runs.fan}
    if "light" in runs.conditions:
        inputs["light"] = runs.conditions["light"]
    for name, values in inputs.items():
        active = values > 0.0
        for way, mask in (("on", active), ("off", ~active)):
            yield Condition(f"the {name} is {way}", mask)
            just = f"the {name} went {way} in the last {JUST_ROWS * step_s / 60.0:g} min"
            yield Condition(just, _just_since(mask))
    temps = np.stack([hold(temp) for temp in runs.temp])
    excess = 0.5 * (temps[:, 1:] + temps[:, :-1]) - runs.ambient
    signals = [("the duty", runs.duty, ""), ("T - T_amb", excess, " K"), ("T_amb", runs.ambient, " degC")]
    if "rel_humidity" in runs.conditions:
        signals.append(("the relative humidity", runs.conditions["rel_humidity"], " %"))
    if "utc" in runs.conditions:
        utc_s = runs.conditions["utc"]
        signals.append(("the time", (utc_s - utc_s.min()) / DAY_S, " days"))
        hour = utc_s % DAY_S / 3600.0
        for begin in range(0, 24, HOURS):
            where = f"between {begin:02d} and {begin + HOURS:02d} h UTC"
            yield Condition(where, (hour >= begin) & (hour < begin + HOURS))
    for name, values, unit in signals:
        for edge in np.unique(np.nanquantile(values, QUANTILES).round(1)):
            yield Condition(f"{name} > {edge:g}{unit}", values > edge)
            yield Condition(f"{name} < {edge:g}{unit}", values < edge)
    row = np.broadcast_to(np.arange(runs.duty.shape[1]), runs.duty.shape)
    yield Condition(f"in the first {FIRST_ROWS} rows of a run", row < FIRST_ROWS)
    for i, name in enumerate(names):
        yield Condition(f"in {name}", np.broadcast_to(np.arange(len(names))[:, None] == i, row.shape))


def _just_since(active: Mask) -> Mask:
    """Return the rows less than JUST_ROWS after it became true, [B, N]."""
    became = np.diff(active.astype(int), axis=1, prepend=1) > 0
    count = np.pad(np.cumsum(became, axis=1), ((0, 0), (JUST_ROWS, 0)))
    return np.asarray(count[:, JUST_ROWS:] > count[:, :-JUST_ROWS])


def regimes(twin: BoxTwin, runs: RunBatch, names: Sequence[str], error_k: Floats) -> list[RegimeEntry]:
    """Return the conditions with clearly more of the squared error than of the rows, the strongest first.

    error_k : [B, N], measured minus predicted by free runs, NaN where not measured
    """
    rows = _Rows.of(error_k, twin.step_s)
    if rows is None:
        return []
    singles = rows.score(conditions(runs, names, twin.step_s))
    pairs = [
        Condition(f"{a.where} and {b.where}", a.mask & b.mask)
        for (_, a), (_, b) in combinations(singles[:PAIRED], 2)
    ]
    ranked = singles + [(SIMPLER * score, item) for score, item in rows.score(pairs)]
    chosen: list[Condition] = []
    for _, item in sorted(ranked, key=lambda scored: -scored[0]):
        if len(chosen) < MOST and not any(rows.is_alike(item, other) for other in chosen):
            chosen.append(item)
    steps = linearise(twin, runs)
    return [rows.regime(item, steps) for item in chosen]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows with a known error, in blocks that are drawn with replacement.

    known : [B, N]; error_k : [R]; begins : first row of each block
    counts : [1 + DRAWS, blocks], how often each block is in a sample; the first is the rows as recorded
    """

    known: Mask
    error_k: Floats
    begins: NDArray[np.intp]
    counts: Floats

    @classmethod
    def of(cls, error_k: Floats, step_s: float) -> "_Rows | None":
        known = np.isfinite(error_k)
        if not np.nansum(error_k**2) > 0.0:
            return None
        run, row = np.nonzero(known)
        block = run * error_k.shape[1] + row // max(5, round(BLOCK_S / step_s))
        begins = np.flatnonzero(np.diff(block, prepend=-1))
        draw = np.random.default_rng(0)  # the same data, the same answer
        counts = draw.multinomial(len(begins), np.full(len(begins), 1.0 / len(begins)), DRAWS)
        return cls(known, error_k[known], begins, np.vstack([np.ones(len(begins)), counts]))

    def score(self, items: Iterable[Condition]) -> list[tuple[float, Condition]]:
        """Return the conditions that clearly have more of the error than of the rows, and by how much."""
        found = []
        for item in items:
            held = self._blocks(item.mask[self.known])
            if held.sum() < FEWEST_ROWS or (held > 0.0).sum() < FEWEST_BLOCKS:
                continue
            error, rows = self._shares(item)
            more = float(error[0] - rows[0] - SURE_SDS * (error - rows)[1:].std())
            if more > 0.0:
                found.append((more, item))
        return sorted(found, key=lambda scored: -scored[0])

    def is_alike(self, one: Condition, other: Condition) -> bool:
        squared, a, b = self.error_k**2, one.mask[self.known], other.mask[self.known]
        return bool(squared[a & b].sum() >= ALIKE * min(squared[a].sum(), squared[b].sum()))

    def regime(self, item: Condition, steps: LinearSteps) -> RegimeEntry:
        error, share = self._shares(item)
        low, high = np.quantile(error[1:], [0.025, 0.975])
        heat_w = self._heat_w(item, steps)
        return {
            "where": item.where,
            "share_of_squared_error": float(error[0]),
            "heat_w": float(heat_w[0]),
            "heat_w_se": float(heat_w[1:].std()),
            "share_low": max(float(low), 0.0),  # rounding may leave it below
            "share_high": float(high),
            "share_of_rows": float(share[0]),
            "rmse_k": float(np.sqrt((self.error_k[item.mask[self.known]] ** 2).mean())),
        }

    def _heat_w(self, item: Condition, steps: LinearSteps) -> Floats:
        """Return the constant heat in a regime that suits the errors best, of each sample.

        By least squares, together with a heat in all other rows.
        """
        heats = [EnsembleRun(steps, None, steps.heat * mask.T[..., None]) for mask in (item.mask, ~item.mask)]
        shown = responses(heats)[:, self.known]
        normal = self.counts @ self._blocks(shown[:, None] * shown).reshape(4, -1).T
        gradient = self.counts @ self._blocks(shown * self.error_k).T
        ridge = 1e-9 * normal[:1, [0, 3]].sum() * np.eye(2)
        sizes = np.linalg.solve(normal.reshape(-1, 2, 2) + ridge, gradient[..., None])
        return np.asarray(sizes[:, 0, 0])

    def _shares(self, item: Condition) -> tuple[Floats, Floats]:
        """Return the shares of squared error and rows of each sample, [1 + DRAWS] each."""
        mask, squared = item.mask[self.known], self.error_k**2
        error, rows = (
            self.counts @ self._blocks(values * mask) / (self.counts @ self._blocks(values))
            for values in (squared, np.ones_like(squared))
        )
        return error, rows

    def _blocks(self, values: Floats | Mask) -> Floats:
        """Add up over each block. values : [..., R]"""
        return np.asarray(np.add.reduceat(values.astype(np.float64), self.begins, axis=-1))
