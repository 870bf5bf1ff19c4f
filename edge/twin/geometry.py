"""Geometry of the greenhouse, known before anything is measured."""

import math
from dataclasses import dataclass, fields

from edge.core.errors import DataError


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
