"""What the table of effects says of each one."""

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect: where it can lie, and where a fit begins."""

    name: str
    unit: str
    low: float
    high: float
    start: float

    def problem(self, value: float) -> str:
        """Why `value` can't be, "" where it can."""
        if not math.isfinite(value):
            return f"{value} is not a finite number"
        if not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            return f"{value:g} is outside {self.low:g}..{self.high:g}{unit}"
        return ""


@dataclass(frozen=True, slots=True)
class Effect:
    """A row of the table.

    add : the function, whose docstring holds the equation
    without : what the residual, measured minus predicted, looks like where the effect is missing
    replaces : an effect that is not applied beside this one
    needs : columns beside the air, the room and the commands that a prediction needs
    """

    add: Callable[..., None]
    parameters: tuple[EffectParameter, ...]
    source: str
    without: str
    replaces: str = ""
    needs: tuple[str, ...] = ()

    def parameter(self, name: str) -> EffectParameter:
        """By name. Errors: KeyError."""
        return {item.name: item for item in self.parameters}[name]
