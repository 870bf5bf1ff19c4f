"""Water in the air: psychrometrics, evaporation of soil and leaf, condensation on the inner sheet."""

import math
from dataclasses import dataclass

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, Number
from firmware_protocol.virtual_board.effects import Effects

KELVIN = 273.15
VAPOUR_GAS_CONSTANT = 461.5  # [J/(kg K)]
EVAPORATION_HEAT = 2.45e6  # at 20 degC [J/kg]


def saturation_pressure(temp_c: float) -> float:
    """Vapour pressure over water [kPa]; Magnus form with the constants of WMO No. 8 (2018), annex 4.B."""
    return 0.6112 * math.exp(17.62 * temp_c / (243.12 + temp_c))


def vapour_pressure(density_kg_m3: Number, temp_c: Number) -> Number:
    """Pressure of vapour as an ideal gas [kPa]."""
    return density_kg_m3 * VAPOUR_GAS_CONSTANT * (temp_c + KELVIN) / 1000.0


def vapour_density(pressure_kpa: Number, temp_c: Number) -> Number:
    """Inverse of vapour_pressure [kg/m³]."""
    return 1000.0 * pressure_kpa / (VAPOUR_GAS_CONSTANT * (temp_c + KELVIN))


@dataclass(slots=True)
class LatentHeat:
    """Heat taken from a node by water that leaves it (negative: given by water that condenses) [W]."""

    plant_w: float = 0.0
    soil_w: float = 0.0
    cover_w: float = 0.0

    @property
    def evaporated_kg_s(self) -> float:
        """Water that soil and leaf lose."""
        return (self.plant_w + self.soil_w) / EVAPORATION_HEAT


class Moisture:
    """Vapour in the box (well mixed) and the film of water on the inner sheet."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, density_kg_m3: float) -> None:
        self._volume_m3 = parameters.box.volume_m3
        self.plant_w_kpa = effects.evapotranspiration * parameters.plant.transpiration_w_kpa
        self.soil_w_kpa = effects.evapotranspiration * parameters.soil.evaporation_w_kpa
        self.dark_share = parameters.plant.dark_share
        # Lewis relation: mass film = heat film / (rho c)
        air = parameters.air
        film_m_s = parameters.cover.inner_film_w_m2_k / (air.density_kg_m3 * air.heat_capacity_j_kg_k)
        self.film_m3_s = effects.condensation * film_m_s * parameters.box.cover_m2
        self.vapour_kg_m3 = density_kg_m3
        self.film_kg = 0.0

    def step(
        self,
        dt_s: float,
        plant_c: float,
        soil_c: float,
        cover_c: float,
        air_c: float,
        light: float,
        wetness: float,
        exchange_m3_s: float,
        outside_kg_m3: float,
    ) -> LatentHeat:
        """Move on by dt_s and say what heat the water took on the way.

        light: 0..1 of full, opens the stomata;  wetness: 0..1, what the soil's moisture lets through
        exchange_m3_s: air exchanged with the room, whose vapour is outside_kg_m3
        """
        # Heat at the vapour of the step's beginning, vapour exactly over the step: explicit alone would
        # swing where the fan changes the air several times in a step.
        pressure = vapour_pressure(self.vapour_kg_m3, air_c)
        stomata = self.dark_share + (1.0 - self.dark_share) * light
        latent = LatentHeat(
            plant_w=self.plant_w_kpa * stomata * wetness * max(saturation_pressure(plant_c) - pressure, 0.0),
            soil_w=self.soil_w_kpa * wetness * max(saturation_pressure(soil_c) - pressure, 0.0),
        )
        condensed = self.film_m3_s * (
            self.vapour_kg_m3 - vapour_density(saturation_pressure(cover_c), cover_c)
        )
        condensed = max(condensed, -self.film_kg / dt_s)  # no more can dry than there is [kg/s]
        self.film_kg += condensed * dt_s
        latent.cover_w = -condensed * EVAPORATION_HEAT
        source = (latent.evaporated_kg_s - condensed) / self._volume_m3
        self.vapour_kg_m3 = relax(
            self.vapour_kg_m3, source, exchange_m3_s / self._volume_m3, outside_kg_m3, dt_s
        )
        return latent


def relax(value: float, source: float, rate: float, outside: float, dt_s: float) -> float:
    """Exact step of dx/dt = source - rate (x - outside), not below 0."""
    if rate * dt_s < 1e-9:
        return max(value + source * dt_s, 0.0)
    end = outside + source / rate
    return max(end + (value - end) * math.exp(-rate * dt_s), 0.0)
