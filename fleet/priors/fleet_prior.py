"""The prior of a new box: the effects that boxes of its kind have, and what each value usually is.

Values are compared as shares of what is usual for the box's heater and step, so kinds of different size can
tell a new kind something.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.baselines import bare
from edge.diagnosis.prior_fit import FAR_SPREADS
from edge.diagnosis.unknowns import with_usual
from edge.twin.draws import uncertain
from edge.twin.provenance import LOSS_SHARE, PRIOR, USUAL_MISS, provenance_numbers
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value
from fleet.priors.population import LEAST_SD, Population, ValuePrior, fit_population
from fleet.priors.shared_structure import LEAST_SHARE, OF_PLACE, in_structure, possible

Floats = NDArray[np.float64]
LIKELY = 0.5  # an effect that no more boxes of the kind have is not begun with: an hour hardly tells it
KINDS_WORTH = 2.0  # boxes: what the whole fleet tells of an effect counts as so many of the kind
# Told as the one that keeps the loss as a value of its own, or that has a cause.
SAME_ANSWER = {"wall_mass": "soil_mass", "unnamed_cut": "heater_derating"}
OF_BOX = (
    "soil_mass", "slow_mass", "heater_lag", "sensor_lag", "imperfect_mixing", "heater_deadtime", "fan_spinup",
    "heater_saturation", "heater_sag", "heater_derating", "natural_convection",
)  # fmt: skip
# Groups that answer alike, by the names of its first and second: a plan without any lag swings, and of two in
# a row one is often taken for the other; a heater that fades in warm air for a loss that grows there.
ALIKE = {
    ("a lag", "two lags"): ("heater_lag", "sensor_lag", "imperfect_mixing", "heater_deadtime"),
    ("a bend", "two bends"): ("natural_convection", "heater_derating"),
}
COUNTS = tuple(name for counts in ALIKE for name in counts)  # at least so many, in shares
PARTS = ("test", "train")  # of a box's rows, in a told twin's provenance
# A twin's own word for what it misses by is believed down to this share of its kind's median: a rig may lie.
BEST_SHARE, LEAST_MISS_K, MOST_MISS_K = 0.5, 0.01, 1e3
FEW = 3  # boxes of a kind, of which one that misses little may know more than the others
KEPT_BOXES = 4096  # in memory
NONE_TOLD: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True, eq=False)
class BoxSheet:
    """A box as the fleet knows it: its name, its kind, and the twin that it adopted."""

    rig: str
    kind: str
    twin: TwinFile


@dataclass(frozen=True, slots=True)
class FarValue:
    """A value of a box that is far from its kind's.

    ratio : to what is usual for the kind; spreads : between them, of the kind's
    """

    effect: str
    parameter: str
    ratio: float
    spreads: float


@dataclass(frozen=True, slots=True, eq=False)
class FleetPrior:
    """The effects that boxes have, by kind, and their values.

    shares : of the boxes of each kind that have an effect; "" for the whole fleet
    values : by effect and parameter, natural logarithm of the value as a share of the usual one
    misses_k : error of free runs by the twins of each kind over rows that no fit saw, median, where known; or
        as what that counts for a new box
    loss_shares : of each kind, what its loss over days is of that which an hour tells, where known
    """

    shares: dict[str, dict[str, float]]
    values: dict[tuple[str, str], Population]
    misses_k: dict[str, float] = field(default_factory=dict)
    loss_shares: Mapping[str, float] = field(default_factory=dict)

    def structure(self, kind: str) -> tuple[str, ...]:
        """Return the effects that a box of this kind likely has, beside those that every twin has."""
        return _likely(self.shares.get(kind, self.shares[""]))

    def start(self, box: TwinFile, kind: str) -> TwinFile:
        """Return the twin that a new box starts from: each value with its spread, none left open.

        box : its description
        Errors : DataError for a fleet that has no box
        """
        file = box
        for name in self.structure(kind):
            if name not in file.effects:
                file = with_usual(file, name)
        known = {place: self._value(file, place, kind) for place in _places(file)}
        told: dict[str, object] = {"kind": kind}
        for key, numbers in ((USUAL_MISS, self.misses_k), (LOSS_SHARE, self.loss_shares)):
            if kind in numbers:
                told[key] = float(f"{numbers[kind]:.3g}")
        file = replace(file, provenance={**file.provenance, PRIOR: told})
        return file.with_values({place: value for place, value in known.items() if value is not None})

    def far_values(self, sheet: BoxSheet) -> list[FarValue]:
        """Return the values of a box that are more than FAR_SPREADS from what is usual for its kind."""
        found = []
        for name, own in _shared_values(sheet, self.structure(sheet.kind)).items():
            about = self.values[name].of_kind(sheet.kind)
            spreads = (own.mean - about.mean) / np.hypot(about.sd, own.sd)
            if abs(spreads) > FAR_SPREADS:
                found.append(FarValue(*name, float(np.exp(own.mean - about.mean)), float(spreads)))
        return found

    def _value(self, file: TwinFile, place: Place, kind: str) -> Value | None:
        population = self.values.get((place[1], place[2]))
        if population is None:
            return None
        about, usual = population.of_kind(kind), file.usual(place)
        value = possible(file, place, usual.start * np.exp(about.mean))
        return Value(float(f"{value:.6g}"), rel_sd=float(f"{about.sd:.3g}"))


def fit_prior(sheets: Sequence[BoxSheet], loss_shares: Mapping[str, float] = NONE_TOLD) -> FleetPrior:
    """Learn from boxes. loss_shares : as of `FleetPrior`. Errors: DataError without any box"""
    if not sheets:
        raise DataError("no box has told its twin yet")
    shares = _shares(sheets)
    found: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for sheet in _speakers(sheets, shares):
        for name, told in _shared_values(sheet, _likely(shares[sheet.kind])).items():
            found.setdefault(name, []).append((told.mean, told.sd, sheet.kind))
    values = {name: fit_population(*zip(*own, strict=True)) for name, own in found.items()}
    return FleetPrior(shares, values, _misses_k(sheets), loss_shares)


def _speakers(sheets: Sequence[BoxSheet], shares: dict[str, dict[str, float]]) -> list[BoxSheet]:
    """Return the boxes whose twins have all effects of their kind; of a kind without such a box all.

    A twin without one has put what it does into other values, which then are not the kind's.
    """
    chosen = []
    for kind in sorted({sheet.kind for sheet in sheets}):
        mine, wanted = [sheet for sheet in sheets if sheet.kind == kind], {*_likely(shares[kind])}
        alike = [sheet for sheet in mine if _common(wanted) <= _common(told_effects(sheet.twin))]
        chosen += alike or mine
    return chosen


def _common(names: set[str]) -> set[str]:
    """Return effects, those that answer alike by their number."""
    return names.difference(*ALIKE.values()) | _numbers(names)


def _numbers(names: set[str]) -> set[str]:
    return {told for counts, group in ALIKE.items() for told in counts[: len(names & {*group})]}


def _misses_k(sheets: Sequence[BoxSheet]) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for sheet in sheets:
        found.setdefault(sheet.kind, []).extend(_missed_k(sheet, PARTS))
    return {kind: float(np.median(own)) for kind, own in found.items() if own}


def _missed_k(sheet: BoxSheet, parts: Sequence[str]) -> list[float]:
    """Return what its twin missed by over the first of these parts that it tells of, if any [K]."""
    told = [error for part in parts for error in provenance_numbers(sheet.twin, "after", part, "rmse_k")]
    return told[:1]


# Seconds a box; priors of two days, or with one box left out, share most of them.
@lru_cache(maxsize=KEPT_BOXES)
def _shared_values(sheet: BoxSheet, names: tuple[str, ...]) -> dict[tuple[str, str], ValuePrior]:
    """Return the values of a box in the structure of its kind, as logarithms of shares of the usual."""
    if {*sheet.twin.effects}.difference(OF_PLACE) == {*bare(sheet.twin).effects, *names}:
        file, sds = sheet.twin, _own_sds(sheet.twin)
    else:
        shared = in_structure(sheet.twin, bare(sheet.twin), names)
        file, sds = shared.file, shared.sds
    told = {}
    for place in _places(file):
        if place[1] in OF_PLACE:
            continue
        share = file.values()[place].value / file.usual(place).start
        sd = max(LEAST_SD, sds.get(place, 0.0))
        told[place[1], place[2]] = ValuePrior(float(np.log(max(share, LEAST_SHARE))), sd)
    return told


def _own_sds(file: TwinFile) -> dict[Place, float]:
    """Return standard deviations of the logarithms of a twin's values, where it is not sure of them."""
    return {
        place: spread.sd
        if spread.log
        else spread.sd / max(spread.middle, LEAST_SHARE * file.usual(place).start)
        for place, spread in uncertain(file).items()
        if place[0] == "effects"
    }


def _places(file: TwinFile) -> Iterator[Place]:
    return (place for place in file.values() if place[0] == "effects")


def _likely(shares: dict[str, float]) -> tuple[str, ...]:
    likely = {name for name in OF_BOX if shares[name] > LIKELY}
    for counts, group in ALIKE.items():
        wanted = sum(shares[name] > LIKELY for name in counts)
        likely |= {*sorted(group, key=lambda name: shares[name], reverse=True)[:wanted]}
    return tuple(name for name in OF_BOX if name in likely)


def _shares(sheets: Sequence[BoxSheet]) -> dict[str, dict[str, float]]:
    """Return which share of each kind has an effect, drawn towards the whole fleet's.

    A box counts by the inverse square of what its twin misses by over the rows that it was fitted to: one
    that misses twice as much as others of its kind lacks something, and does not know what.
    """
    names, every = (*OF_BOX, *COUNTS), [told_effects(sheet.twin) for sheet in sheets]
    kinds = np.array([sheet.kind for sheet in sheets])
    counts = np.ones(len(sheets))
    for kind in {*kinds}:
        counts[kinds == kind] = _counts([sheet for sheet in sheets if sheet.kind == kind])
    have = counts[:, None] * np.array([[name in own for name in names] for own in every])
    whole = have.mean(axis=0)
    shares = {"": dict(zip(names, whole.tolist(), strict=True))}
    for kind in {*kinds}:
        mine = have[kinds == kind]
        drawn = (mine.sum(axis=0) + KINDS_WORTH * whole) / (len(mine) + KINDS_WORTH)
        shares[str(kind)] = dict(zip(names, drawn.tolist(), strict=True))
    return shares


def _counts(sheets: Sequence[BoxSheet]) -> Floats:
    """Return what each box of a kind counts, 1 in the mean, [n]."""
    missed = [_missed_k(sheet, PARTS[::-1]) for sheet in sheets]
    usual_k = min(float(np.median([own[0] for own in missed if own] or [1.0])), MOST_MISS_K)
    known = np.array([min(own[0], MOST_MISS_K) if own else usual_k for own in missed])
    least_k = BEST_SHARE * max(usual_k, LEAST_MISS_K)
    counts = np.square(least_k / np.maximum(known, least_k))
    if len(sheets) > FEW:  # one alone is no majority
        counts = np.minimum(counts, counts.sum() - counts)
    return np.asarray(counts / counts.mean())


def told_effects(twin: TwinFile) -> set[str]:
    """Return the effects of a twin, those that answer alike by one name, and how many of each group."""
    found = {SAME_ANSWER.get(name, name) for name in twin.effects}
    return found | _numbers(found)
