"""The library of named effects: what the base balance leaves out. One function and one table row each.

A function is given the network and its parameters and adds the effect; its row stands below it in the same
file and holds everything that the diagnosis knows about the effect. To add one: docs/add-an-effect.md.
"""

from collections.abc import Iterable, Mapping, Sequence

from edge.core.errors import DataError
from edge.formats.cross_check import nearest
from edge.twin.effects.air import AIR_EFFECTS
from edge.twin.effects.effect import BlindRuns, Effect, EffectParameter, Offer
from edge.twin.effects.formulas import UNNAMED_EFFECTS
from edge.twin.effects.further import FURTHER_EFFECTS
from edge.twin.effects.heater import HEATER_EFFECTS
from edge.twin.effects.loss import LOSS_EFFECTS
from edge.twin.effects.signal import SIGNAL_EFFECTS
from edge.twin.geometry import Geometry
from edge.twin.network import Network
from edge.twin.scale import USUAL_STEP_S, scale_of

Effects = Mapping[str, Mapping[str, float]]
EFFECTS: dict[str, Effect] = {
    **LOSS_EFFECTS, **HEATER_EFFECTS, **AIR_EFFECTS, **SIGNAL_EFFECTS, **FURTHER_EFFECTS, **UNNAMED_EFFECTS
}  # fmt: skip
USUAL_EFFECTS: dict[str, Effect] = {
    name: effect for name, effect in EFFECTS.items() if effect.offer is Offer.CANDIDATE
}


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


def common_effects() -> list[str]:
    """Effects that most boxes have more or less of, by rank."""
    return sorted((name for name in EFFECTS if EFFECTS[name].common), key=lambda name: EFFECTS[name].common)


def hidden_by(runs: BlindRuns) -> dict[str, str]:
    """Effects that such recordings hide, and what each looks like in them."""
    found = [(item, name) for name, effect in EFFECTS.items() for item in effect.hidden_by]
    ordered = sorted(found, key=lambda entry: entry[0].place)
    return {name: item.looks_like for item, name in ordered if item.runs is runs}
