"""From where a candidate effect is fitted: several sets of values where a likelihood has several tops."""

from dataclasses import replace

from edge.twin.effects.effect import Effect, EffectParameter, ParameterKind, Values
from edge.twin.effects.library import EFFECTS
from edge.twin.scale import USUAL_STEP_S
from edge.twin.twin_file import TwinFile
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


def settle(file: TwinFile) -> TwinFile:
    """Return the file with fixed values."""
    return file.with_values({place: Value(value.value) for place, value in file.values().items()})
