"""The library of named effects: what the base balance leaves out. One function and one table row each.

A function is given the network and its parameters and adds the effect; its row stands below it in `named.py`
and holds everything that the diagnosis knows about the effect. To add one: docs/add-an-effect.md.

Heat without a name (`formulas`) is a smooth step over the air temperature and so stays what it was beyond the
data; neither formula is ever offered as a name.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from edge.core.errors import DataError
from edge.formats.cross_check import nearest
from edge.twin.effects.effect import BlindRuns, Effect, EffectParameter, Offer, ParameterKind, by_name
from edge.twin.effects.named import (
    AIR_EFFECTS,
    FURTHER_EFFECTS,
    HEATER_EFFECTS,
    LOSS_EFFECTS,
    SIGNAL_EFFECTS,
)
from edge.twin.geometry import USUAL_STEP_S, Geometry, scale_of
from edge.twin.network import Network
from edge.twin.signals import Floats, HeatConditions

LARGEST_POWER = 40.0  # of e: a step that is as good as whole


def unnamed_heat(network: Network, P_x: float, T_x: float, w_x: float) -> None:
    """Heat of no known cause in a cool box: Q = P_x / (1 + exp((T - T_x) / w_x))."""
    network.heat(lambda now: np.asarray(P_x * (1.0 - _warm(now.temp, T_x, w_x))), by_temp=True)


def unnamed_cut(network: Network, f_x: float, T_x: float, w_x: float) -> None:
    """Share of the heater's heat that a warm box does not get: Q = -f_x H / (1 + exp((T_x - T) / w_x))."""
    full_w = network.geometry.heater_max_w

    def flow(now: HeatConditions) -> Floats:
        return np.asarray(-f_x * full_w * now.column["heater_duty"] * _warm(now.temp, T_x, w_x))

    network.heat(flow, by_temp=True)


def _warm(temp: Floats, middle_c: float, width_k: float) -> Floats:
    """0 in a cool box, 1 in a warm one."""
    away = np.clip((temp - middle_c) / width_k, -LARGEST_POWER, LARGEST_POWER)
    return np.asarray(1.0 / (1.0 + np.exp(-away)))


_TURNING = (
    EffectParameter("T_x", "°C", -20.0, 300.0, 30.0, ParameterKind.TURNING_POINT),
    EffectParameter("w_x", "K", 0.2, 20.0, 1.5),
)
UNNAMED_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        unnamed_heat,
        (EffectParameter("P_x", "W", -200.0, 200.0, 10.0), *_TURNING),
        source="a bounded step, as a neuron of a network has it; stands for what was not found",
        without="positive or negative while the box is cool",
        offer=Offer.NAMELESS,
        stands_in=True,
    ),
    Effect(
        unnamed_cut,
        (EffectParameter("f_x", "", 0.0, 1.0, 0.4), *_TURNING),
        source="a bounded step, as a thermal cut-out makes it; stands for what was not found",
        without="negative in proportion to the duty while the box is warm",
        offer=Offer.NAMELESS,
        stands_in=True,
        gentler="heater_derating",
    ),
)


Effects = Mapping[str, Mapping[str, float]]
EFFECTS: dict[str, Effect] = {
    **LOSS_EFFECTS, **HEATER_EFFECTS, **AIR_EFFECTS, **SIGNAL_EFFECTS, **FURTHER_EFFECTS, **UNNAMED_EFFECTS
}  # fmt: skip
USUAL_EFFECTS: dict[str, Effect] = {
    name: effect for name, effect in EFFECTS.items() if effect.offer is Offer.CANDIDATE
}


def nameless(effects: Iterable[str]) -> list[str]:
    """Return the effects that stand for a cause that was not found."""
    return [name for name in effects if EFFECTS[name].offer is Offer.NAMELESS]


def add_effect(effect: Effect) -> None:
    """Make an effect known to this process, as if it stood in this folder; before any diagnosis begins.

    Errors : ValueError for a name that an effect has
    """
    if effect.name in EFFECTS:
        raise ValueError(f"{effect.name}: the library has an effect of this name")
    EFFECTS[effect.name] = effect
    if effect.offer is Offer.CANDIDATE:
        USUAL_EFFECTS[effect.name] = effect


def build(geometry: Geometry, effects: Effects, step_s: float = USUAL_STEP_S) -> Network:
    """Build the base balance with effects added. Errors: DataError, `effects.wall_loss.UA: ...`"""
    scale = scale_of(geometry.heater_max_w, step_s)
    for name, values in effects.items():
        check_names(name, values)
        for parameter in EFFECTS[name].parameters:
            if problem := scale.possible(parameter).problem(values[parameter.name]):
                raise DataError(f"effects.{name}.{parameter.name}: {problem}")
    network = Network(geometry)
    for name in acting_effects(effects):
        EFFECTS[name].add(network, **effects[name])
    return network


def check_names(name: str, parameters: Iterable[str]) -> None:
    """Refuse an unknown effect, and parameters that are not exactly its own. Errors: DataError."""
    if name not in EFFECTS:
        raise DataError(f"effects: unknown effect {name!r}; {nearest(str(name), EFFECTS)}")
    own = [item.name for item in EFFECTS[name].parameters]
    given = list(parameters)
    for key in given:
        if key not in own:
            raise DataError(f"effects.{name}: unknown parameter {key!r}; {nearest(str(key), own)}")
    for key in own:
        if key not in given:
            raise DataError(f"effects.{name}.{key}: missing")


def acting_effects(effects: Iterable[str]) -> list[str]:
    """Return the effects that act: not those that another one here replaces."""
    names = list(effects)
    replaced = {EFFECTS[name].replaces for name in names}
    return [name for name in names if name not in replaced]


def needs(effects: Iterable[str]) -> dict[str, str]:
    """Columns that a prediction needs, and the first effect that needs each."""
    found: dict[str, str] = {}
    for name in acting_effects(effects):
        for column in EFFECTS[name].needs:
            found.setdefault(column, name)
    return found


def parameter_at(place: Sequence[str]) -> EffectParameter | None:
    """Return the parameter at `("effects", NAME, PARAMETER)`, None at any other place of a twin file."""
    return EFFECTS[place[1]].parameter(place[2]) if place[0] == "effects" else None


def day_counter(effects: Iterable[str]) -> str:
    """Return the first effect that counts days from `day0_utc`, "" where none does."""
    return next((name for name in effects if EFFECTS[name].counts_days), "")


def hidden_by(runs: BlindRuns) -> dict[str, str]:
    """Effects that such recordings hide, and what each looks like in them."""
    found = [(item, name) for name, effect in EFFECTS.items() for item in effect.hidden_by]
    ordered = sorted(found, key=lambda entry: entry[0].place)
    return {name: item.looks_like for item, name in ordered if item.runs is runs}
