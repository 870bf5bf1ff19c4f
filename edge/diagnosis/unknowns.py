"""The numbers of a twin file that a fit may move, scaled so that a step of 1 is large, and their start
values.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.twin.effects.effect import Effect, EffectParameter, ParameterKind, Values
from edge.twin.effects.library import EFFECTS, acting_effects
from edge.twin.fit import GEOMETRY_RANGE
from edge.twin.geometry import USUAL_STEP_S
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value


def with_usual(file: TwinFile, name: str) -> TwinFile:
    """Return the file with one more effect to be fitted from its usual values."""
    return _add(
        file,
        name,
        {item.name: file.usual(("effects", name, item.name)).start for item in EFFECTS[name].parameters},
    )


def with_effect(file: TwinFile, name: str) -> list[TwinFile]:
    """Return the file with one more effect to be fitted, from each of its starts."""
    effect = EFFECTS[name]
    if effect.starts_beside is not None:
        replaced = {key: value.value for key, value in file.effects.get(effect.replaces, {}).items()}
        return [_add(file, name, values) for values in effect.starts_beside(replaced, file.scale.of)]
    if not effect.starts:
        return [with_usual(file, name)]
    return [_add(file, name, _scale(file, effect, values)) for values in effect.starts]


def _scale(file: TwinFile, effect: Effect, values: Values) -> Values:
    """Values of the paper's box, for this one."""
    return {key: _in_this_box(file, effect.parameter(key), value) for key, value in values.items()}


def _in_this_box(file: TwinFile, parameter: EffectParameter, value: float) -> float:
    if parameter.kind is ParameterKind.DEAD_TIME:
        return value * file.sample_s / USUAL_STEP_S
    return value * file.scale.of(parameter.unit)


def _add(file: TwinFile, name: str, values: Values) -> TwinFile:
    return replace(
        file,
        effects={**file.effects, name: {key: Value(value, fit=True) for key, value in values.items()}},
    )


Floats = NDArray[np.float64]
LOG_PRIOR_SD = 4.0  # of what nothing is known but its usual size
GEOMETRY_PRIOR_SD = 3.0  # the same for a geometry value that is to be fitted
LINEAR_PRIOR_SHARE = 0.5  # of the range of a value that may be 0 or negative
TEMPERATURE_K = 5.0  # of a temperature: its usual value is no measure of how far it may be off
PATH_SD = 0.005  # relative, of a loss that two values in series must give, where it is known as exact


@dataclass(frozen=True, slots=True)
class UnknownValue:
    """A number to be found: value = exp(x) where `log`, else scale * x."""

    place: Place
    low: float
    high: float
    log: bool
    scale: float
    mean: float  # of its prior, in its coordinate
    sd: float

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a value, inside the bounds."""
        inside = min(max(value, self.low), self.high)
        return float(np.log(inside)) if self.log else inside / self.scale

    def value(self, coordinate: float) -> float:
        """Inside the bounds, whatever the coordinate."""
        raw = float(np.exp(min(coordinate, 700.0))) if self.log else coordinate * self.scale
        return min(max(raw, self.low), self.high)

    @property
    def bounds(self) -> tuple[float, float]:
        """The lowest and the highest coordinate."""
        return self.coordinate(self.low), self.coordinate(self.high)


def unknowns(file: TwinFile) -> tuple[UnknownValue, ...]:
    """Return the values of `file` that are to be fitted or uncertain,
    without those that another effect replaces.
    """
    acting = set(acting_effects(file.effects))
    return tuple(
        _unknown(file, place, value)
        for place, value in file.values().items()
        if (value.fit or value.rel_sd is not None) and (place[0] == "geometry" or place[1] in acting)
    )


def _unknown(file: TwinFile, place: Place, value: Value) -> UnknownValue:
    if place[0] == "geometry":
        low, high = (share * value.value for share in GEOMETRY_RANGE)
        sd = GEOMETRY_PRIOR_SD if value.rel_sd is None else value.rel_sd
        return UnknownValue(place, low, high, True, 1.0, float(np.log(value.value)), sd)
    parameter = file.possible(place)
    if parameter.low > 0.0:
        sd = LOG_PRIOR_SD if value.rel_sd is None else value.rel_sd
        begun = min(max(value.value, parameter.low), parameter.high)
        return UnknownValue(place, parameter.low, parameter.high, True, 1.0, float(np.log(begun)), sd)
    parameter = replace(file.usual(place), high=parameter.high)
    return _linear(place, value, parameter, file.scale.of(parameter.unit))


def _linear(place: Place, value: Value, parameter: EffectParameter, factor: float) -> UnknownValue:
    # A range is never narrower than the table's: in a small box only a small part of it is usual.
    table = EFFECTS[place[1]].parameter(place[2])
    usual = (table.high - table.low) * min(1.0, factor)
    scale = TEMPERATURE_K if parameter.unit == "°C" else abs(parameter.start) or 0.1 * usual
    sd = LINEAR_PRIOR_SHARE * usual if value.rel_sd is None else max(abs(value.rel_sd * value.value), 1e-9)
    return UnknownValue(place, parameter.low, parameter.high, False, scale, value.value / scale, sd / scale)


def place_unknowns(file: TwinFile, free: Sequence[UnknownValue], coordinates: Floats) -> TwinFile:
    """Return the file with the unknowns at `coordinates`, still to be fitted."""
    values = file.values()
    return file.with_values(
        {
            item.place: Value(item.value(x), rel_sd=values[item.place].rel_sd, fit=values[item.place].fit)
            for item, x in zip(free, coordinates, strict=True)
        }
    )


def path_priors(file: TwinFile) -> list[float]:
    """How far replaced and replacing effects are from what they must agree on, in standard deviations.

    A known loss of the walls says what the two films of a wall that stores heat give in series.
    """
    found = []
    for name, own in file.effects.items():
        effect = EFFECTS[name]
        known = file.effects.get(effect.replaces, {})
        if effect.amounts_to is None or not known:
            continue
        worth = effect.amounts_to({key: value.value for key, value in own.items()})
        found += [
            float(np.log(value / known[key].value)) / (known[key].rel_sd or PATH_SD)
            for key, value in worth.items()
            if not known[key].fit and known[key].value > 0.0
        ]
    return found
