"""The library of named effects: what the base balance leaves out. One function and one table row each.

A function is given the network and its parameters and adds the effect; its row stands below it in the same
file. To add one, write both, and an example in tests/edge/twin/test_twin_equations.py.
"""

from collections.abc import Iterable, Mapping

from edge.core.errors import DataError
from edge.formats.checked import nearest
from edge.twin.effects.air import AIR_EFFECTS
from edge.twin.effects.effect import Effect
from edge.twin.effects.further import FURTHER_EFFECTS
from edge.twin.effects.heater import HEATER_EFFECTS
from edge.twin.effects.loss import LOSS_EFFECTS
from edge.twin.effects.signal import SIGNAL_EFFECTS
from edge.twin.effects.unnamed import UNNAMED_EFFECTS
from edge.twin.geometry import Geometry
from edge.twin.network import Network
from edge.twin.scale import USUAL_STEP_S, scale_of

Effects = Mapping[str, Mapping[str, float]]
USUAL_EFFECTS: Mapping[str, Effect] = {**LOSS_EFFECTS, **HEATER_EFFECTS, **AIR_EFFECTS, **SIGNAL_EFFECTS}
EFFECTS: Mapping[str, Effect] = {**USUAL_EFFECTS, **FURTHER_EFFECTS, **UNNAMED_EFFECTS}


def build(geometry: Geometry, effects: Effects, step_s: float = USUAL_STEP_S) -> Network:
    """The base balance with effects added. Errors: DataError, `effects.wall_loss.UA: ...`."""
    scale = scale_of(geometry.heater_max_w, step_s)
    for name, values in effects.items():
        check_names(name, values)
        for parameter in EFFECTS[name].parameters:
            if problem := scale.possible(parameter).problem(values[parameter.name]):
                raise DataError(f"effects.{name}.{parameter.name}: {problem}")
    network = Network(geometry)
    for name in applied(effects):
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


def applied(effects: Iterable[str]) -> list[str]:
    """The effects that act: not those that another one here replaces."""
    names = list(effects)
    replaced = {EFFECTS[name].replaces for name in names}
    return [name for name in names if name not in replaced]


def needs(effects: Iterable[str]) -> dict[str, str]:
    """Columns that a prediction needs, and the first effect that needs each."""
    found: dict[str, str] = {}
    for name in applied(effects):
        for column in EFFECTS[name].needs:
            found.setdefault(column, name)
    return found
