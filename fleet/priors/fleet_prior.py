"""The prior of a new box: the effects that boxes of its kind have, and what each value usually is.

Values are compared as shares of what is usual for the box's heater and step, so kinds of different size can
tell a new kind something.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from edge.core.errors import DataError
from edge.diagnosis.unknowns import with_usual
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import SDS_95, Value
from fleet.priors.population import LEAST_SD, Population, ValuePrior, fit_population
from fleet.priors.shared_structure import in_structure

LIKELY = 0.5  # an effect that is rarer among boxes of the kind is not begun with
KINDS_WORTH = 2.0  # boxes: what the whole fleet tells of an effect counts as so many of the kind
ALWAYS = ("wall_loss", "extra_capacity")
BY_FAN = {"exhaust": ("fan_effectiveness",), "stirring": ("stirred_loss",), "none": ()}
SAME_ANSWER = {"wall_mass": "soil_mass"}  # told as the one that keeps the loss as a value of its own
OF_BOX = ("soil_mass", "heater_lag", "sensor_lag", "imperfect_mixing", "heater_saturation", "heater_sag")
ANSWERS_ALIKE = {"soil_mass": "wall_mass", "wall_loss": "wall_mass"}
UNTOLD_SD = 1.5  # as a share, of a value of which a twin says nothing
FAR_SPREADS = 3.0  # one value in 370 of those that are spread like their kind's
KEPT_BOXES = 4096  # in memory
LEAST_SHARE = 1e-6  # of what is usual: the logarithm needs more than nothing


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
    """

    shares: dict[str, dict[str, float]]
    values: dict[tuple[str, str], Population]

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
        value = float(np.clip(usual.start * np.exp(about.mean), max(usual.low, 1e-9), usual.high))
        return Value(float(f"{value:.6g}"), rel_sd=float(f"{about.sd:.3g}"))


def fit_prior(sheets: Sequence[BoxSheet]) -> FleetPrior:
    """Learn from boxes. Errors: DataError without any"""
    if not sheets:
        raise DataError("no box has told its twin yet")
    shares = _shares(sheets)
    found: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for sheet in sheets:
        for name, told in _shared_values(sheet, _likely(shares[sheet.kind])).items():
            found.setdefault(name, []).append((told.mean, told.sd, sheet.kind))
    values = {name: fit_population(*zip(*own, strict=True)) for name, own in found.items()}
    return FleetPrior(shares, values)


# Seconds a box; priors of two days, or with one box left out, share most of them.
@lru_cache(maxsize=KEPT_BOXES)
def _shared_values(sheet: BoxSheet, names: tuple[str, ...]) -> dict[tuple[str, str], ValuePrior]:
    """Return the values of a box in the structure of its kind, as logarithms of shares of the usual."""
    shared = in_structure(sheet.twin, bare(sheet.twin), names).file
    shares = {
        (place[1], place[2]): shared.values()[place].value / shared.usual(place).start
        for place in _places(shared)
    }
    return {
        name: ValuePrior(float(np.log(max(share, LEAST_SHARE))), _told_sd(sheet.twin, *name))
        for name, share in shares.items()
    }


def _told_sd(twin: TwinFile, effect: str, parameter: str) -> float:
    """Return how well a box's own twin knows a value, as a share of it.

    Where the twin has another effect that answers alike, as well as it knows the worst of that one's values.
    """
    own = twin.effects.get(effect, {})
    if parameter in own:
        return _relative_sd(own[parameter])
    alike = twin.effects.get(ANSWERS_ALIKE.get(effect, ""), {})
    return max(map(_relative_sd, alike.values()), default=UNTOLD_SD)


def _relative_sd(value: Value) -> float:
    if value.low is None or value.high is None or not value.value > 0.0:
        return LEAST_SD
    if value.low > 0.0:
        return max(LEAST_SD, float(np.log(value.high / value.low)) / (2.0 * SDS_95))
    return max(LEAST_SD, (value.high - value.low) / value.value / (2.0 * SDS_95))


def bare(twin: TwinFile) -> TwinFile:
    """Return a twin's box without what was found out about it."""
    file = replace(twin, effects={}, provenance={})
    for name in (*ALWAYS, *BY_FAN[twin.fan_role]):
        file = with_usual(file, name)
    return file


def _places(file: TwinFile) -> Iterator[Place]:
    return (place for place in file.values() if place[0] == "effects")


def _likely(shares: dict[str, float]) -> tuple[str, ...]:
    return tuple(name for name in OF_BOX if shares[name] >= LIKELY)


def _shares(sheets: Sequence[BoxSheet]) -> dict[str, dict[str, float]]:
    """Return which share of each kind has an effect, drawn towards the whole fleet's."""
    have = [{SAME_ANSWER.get(name, name) for name in sheet.twin.effects} for sheet in sheets]
    whole = {name: float(np.mean([name in own for own in have])) for name in OF_BOX}
    shares = {"": whole}
    for kind in {sheet.kind for sheet in sheets}:
        mine = [own for own, sheet in zip(have, sheets, strict=True) if sheet.kind == kind]
        shares[kind] = {
            name: (sum(name in own for own in mine) + KINDS_WORTH * whole[name]) / (len(mine) + KINDS_WORTH)
            for name in OF_BOX
        }
    return shares
