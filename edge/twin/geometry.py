"""Geometry of the greenhouse, known before anything is measured, and its scale beside the usual one.

The balance stays the same where all heats, and with them losses, capacities and flows, are multiplied by one
factor, and where time is by another, capacities with it. So a usual value, a range or a prior that suits the
paper's box suits any, once it is multiplied by these two.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache

from edge.core.errors import DataError
from edge.twin.effects.effect import EffectParameter, ParameterKind

USUAL_HEATER_W, USUAL_STEP_S, USUAL_ANSWER_S = 100.0, 60.0, 150.0  # of the paper's box
SLOWER = 10.0  # or quicker, than its steps tell
WIDE = 1e4  # times or below the usual range: a metal block in a matchbox, an oven of kilowatts
# By unit: powers of the two factors.
POWERS = {
    "W": (1, 0), "W/K": (1, 0), "W/kPa": (1, 0), "m²": (1, 0), "m³/s": (1, 0), "J/K": (1, 1), "s": (0, 1),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scale:
    """heat : power of the heater, time : of answers, both in those of the paper's box"""

    heat: float = 1.0
    time: float = 1.0

    def of(self, unit: str) -> float:
        """Factor of a value in this unit; 1 for one that has nothing to do with size or speed."""
        heat, time = POWERS.get(unit, (0, 0))
        return float(self.heat**heat * self.time**time)

    def usual(self, parameter: EffectParameter) -> EffectParameter:
        """With its start where it usually is in such a box, and a range that is only ever wider."""
        factor = self.of(parameter.unit)
        low = parameter.low * (min(1.0, factor) if parameter.low > 0.0 else max(1.0, factor))
        return replace(
            parameter, low=low, high=parameter.high * max(1.0, factor), start=parameter.start * factor
        )

    @lru_cache(maxsize=512)  # noqa: B019 - looked up for each twin that a fit makes, of few scales
    def possible(self, parameter: EffectParameter) -> EffectParameter:
        """With the widest range that a box of such a heater, recorded in such steps, may have."""
        slow, quick = replace(self, time=self.time * SLOWER), replace(self, time=self.time / SLOWER)
        low, high = quick.usual(parameter).low, slow.usual(parameter).high
        if parameter.unit in POWERS or parameter.kind is ParameterKind.AIR_CAPACITIES:
            if parameter.kind is not ParameterKind.AIR_CAPACITIES:
                low *= WIDE if low < 0.0 else 1.0 / WIDE
            high *= WIDE
        return replace(parameter, low=low, high=high)


def scale_of(heater_w: float, step_s: float, answer_s: float | None = None) -> Scale:
    """answer_s : time constant of the box, None where it is not known

    Steps are chosen to fit a box, so they tell its speed too: where both are known, their geometric mean.
    """
    steps = step_s / USUAL_STEP_S
    time = steps if answer_s is None else (steps * answer_s / USUAL_ANSWER_S) ** 0.5
    time = min(max(time, steps / SLOWER), steps * SLOWER)  # what `possible` lets a file have
    return Scale(heater_w / USUAL_HEATER_W, time)


@dataclass(frozen=True, slots=True)
class Geometry:
    """The paper's box. Errors: DataError naming the key, for a value that is not a finite number above 0."""

    volume_m3: float = 0.15  # 50 x 50 x 60 cm
    heater_max_w: float = 100.0
    fan_max_m3_s: float = 68.0 / 3600.0  # 68 m³/h
    air_density_kg_m3: float = 1.2
    air_heat_capacity_j_kg_k: float = 1005.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (value > 0.0 and math.isfinite(value)):
                raise DataError(f"geometry.{item.name}: {value:g} is not a finite number above 0")

    @property
    def volumetric_heat_j_m3_k(self) -> float:
        """rho c of air [J/(m³ K)]."""
        return self.air_density_kg_m3 * self.air_heat_capacity_j_kg_k

    @property
    def air_capacity_j_k(self) -> float:
        """Heat capacity of the air in the box, rho c V [J/K]."""
        return self.volumetric_heat_j_m3_k * self.volume_m3
