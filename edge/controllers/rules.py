"""Hysteresis thermostat: the fallback that needs no model."""

import math
from dataclasses import dataclass

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS, levels_allowed

DEADBAND_K = 0.5  # half-width: the box cools and heats by less than this in a fraction of a minute
COOLING_DEADBAND_K = 1.5  # the fan starts later than the heater stops, so that they never fight


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Distances from the reference [K]: of heat below it, of cooling above it."""

    heat_below_k: float = DEADBAND_K
    heat_until_k: float = -DEADBAND_K
    cool_above_k: float = COOLING_DEADBAND_K
    cool_until_k: float = 0.0


class Rules:
    """Full heat below the band, none above it; the fan runs from further above until the reference."""

    def __init__(self, thresholds: Thresholds | None = None, name: str = "rules") -> None:
        """Set the thresholds; None: those of the fallback."""
        self.name = name
        self._thresholds = thresholds or Thresholds()

    def reset(self) -> None:
        """Nothing to forget: its memory is the command last sent."""

    def decide(self, context: Context) -> Decision:
        """Heater and fan for this step; both off when the temperature is not known."""
        temp, reference = context.estimate.temp_air, float(context.reference[0])
        limits, last = context.limits, context.last_sent
        error = temp - reference
        at = self._thresholds
        heat = _hysteresis(-error, last.heater_duty > 0.0, at.heat_below_k, at.heat_until_k)
        heat = heat and temp < limits.temp_air_max_c
        cool = _hysteresis(error, last.fan_on, at.cool_above_k, at.cool_until_k)
        if limits.fan_hold_steps > 0:
            cool = last.fan_on
        duty = levels_allowed(limits.heater_max_duty) / HEATER_LEVELS if heat else 0.0
        rule = _words(math.isfinite(error), heat, cool)
        why = {"rule": rule, "reference_c": reference, "deadband_k": at.heat_below_k}
        return Decision(Command(heater_duty=duty, fan_on=cool), self.name, why=why)


def _hysteresis(excess: float, was_on: bool, on_above: float, off_below: float) -> bool:
    """On above one threshold, off below the other, else as before; NaN is off."""
    if excess > on_above:
        return True
    return was_on and excess > off_below


def _words(known: bool, heat: bool, cool: bool) -> str:
    if not known:
        return "air temperature or reference unknown: heater off"
    if heat:
        return "below the reference: heat"
    return "above the reference: cool" if cool else "inside the deadband: wait"
