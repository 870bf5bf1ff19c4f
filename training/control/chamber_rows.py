"""The virtual rig's chamber for many boxes at once, each with inputs of its own and one future of the room.

It shares parameters, disturbances and thermal network with `firmware_protocol.virtual_board.chamber`, and has
its water by arrays; CO2, light, watering and noise of sensors do not act on heat and are left out.
"""

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.humidity import (
    EVAPORATION_HEAT,
    Moisture,
    saturation_pressure,
    vapour_density,
    vapour_pressure,
)
from firmware_protocol.virtual_board.network import (
    SMALLEST_DIFFERENCE_K,
    WELL_MIXED_W_K,
    Loads,
    NetworkEquations,
)
from firmware_protocol.virtual_board.plant import Fan, HeaterSupply
from firmware_protocol.virtual_board.weather import Weather

Floats = NDArray[np.float64]
ABSENT = (  # effects that this copy does not have
    "heater_saturation", "heater_sag", "heater_deadtime", "heater_thermostat", "fan_deadtime", "fan_clogging",
    "door_opening", "stack_ventilation", "sensor_radiation", "sun_window", "constant_heat", "heat_noise",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class BoxStates:
    """States of B boxes at one time.

    temps : [7, B] as `network.ThermalNetwork` has them [degC]; the others [B]: vapour [kg/m³], film and soil
        water [kg], the sensor's own temperature [degC], fan speed 0..1
    """

    temps: Floats
    vapour: Floats
    film: Floats
    soil: Floats
    sensor: Floats
    fan: Floats

    def of(self, places: NDArray[np.int64]) -> "BoxStates":
        """Those at `places`, in their order, one more than once too."""
        return BoxStates(
            *(np.take(getattr(self, field.name), places, axis=-1) for field in fields(BoxStates))
        )


class _NetworkRows(NetworkEquations):
    """The same equations for temperatures [7, B]."""

    def _between(self, one: Floats, other: Floats, share: float) -> Floats:
        return one + share * (other - one)

    def _nodes(self, *temps: Floats) -> Floats:
        return np.stack(temps)

    def _growth(self, difference_k: Floats, reference_k: float, power: float) -> Floats:
        ratio = np.maximum(np.abs(difference_k), SMALLEST_DIFFERENCE_K) / reference_k
        return (
            np.sqrt(np.sqrt(ratio)) if power == 0.25 else np.asarray(ratio**power)
        )  # a power takes ten roots' time

    def _at_most_mixed(self, exchange_w_k: Floats) -> Floats:
        return np.minimum(exchange_w_k, WELL_MIXED_W_K)


class ChamberRows:
    """Moves boxes on; the room's future is the seed's, asked in the order of time."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        """Copy a chamber. Raises ValueError for an effect that this copy does not have"""
        for name in ABSENT:
            if getattr(effects, name) != 0.0:
                raise ValueError(f"effects.{name}: {getattr(effects, name):g}, only 0 is known here")
        self.p, self.e = parameters, effects
        self._network = _NetworkRows(parameters, effects)
        self._weather = Weather(parameters, effects, seed)
        self._heater = HeaterSupply(parameters, effects, seed)
        self._fan = Fan(parameters, effects)
        self._moisture = Moisture(parameters, effects, 0.0)

    def start(self, count: int = 1) -> BoxStates:
        """Boxes that have long stood in the room, at time 0."""
        room = np.full(count, self._weather.temp_c)
        soil = np.full(count, self.p.soil.water_start * self.p.soil.water_capacity_kg)
        vapour = np.full(count, self._room_vapour())
        return BoxStates(np.tile(room, (7, 1)), vapour, np.zeros(count), soil, room, np.zeros(count))

    def air(self, boxes: BoxStates) -> Floats:
        """Mean air temperature [degC]."""
        share = self.p.box.heater_zone_share
        return np.asarray(share * boxes.temps[5] + (1.0 - share) * boxes.temps[6])

    def reading(self, boxes: BoxStates) -> Floats:
        """Return the reading of a sensor without noise and steps [degC]."""
        return boxes.sensor + self.e.sensor_bias * self.p.sensors.air_bias_k

    def step(self, boxes: BoxStates, time_s: float, dt_s: float, heat: Floats, fan: Floats) -> BoxStates:
        """dt_s later. heat, fan : [B], share of the time that the heater's relay is closed, fan's 0 or 1"""
        p, e = self.p, self.e
        # The weather of the step's middle stands for the step, as on the board.
        middle_s = time_s + 0.5 * dt_s
        self._weather.at(middle_s)
        speed, mean_speed = self._fan.spun_up(boxes.fan, fan, dt_s)
        flow = self._fan.full_flow_m3_s * mean_speed
        ageing = max(1.0 + e.ua_drift * p.cover.ua_drift_per_day * self._weather.day, 0.1)
        leak = e.infiltration * p.air.leak_flow_m3_s * (1.0 - mean_speed) * ageing
        capacity = p.air.density_kg_m3 * p.air.heat_capacity_j_kg_k
        latent, boxes = self._water(boxes, dt_s, flow + leak)
        motor = e.fan_motor_heat * p.fan.motor_heat_w * mean_speed
        loads = Loads(
            room_c=self._weather.temp_c,
            draught=self._weather.draught,
            ageing=ageing,
            fan_speed=mean_speed,
            ventilation_w_k=capacity * flow,
            leak_w_k=capacity * leak,
            heater_w=self._heater.power_w(1.0, dt_s, middle_s, 0.0) * heat,
            upper_w=0.0,
            lower_w=motor,
            plant_w=-latent[0],
            soil_w=-latent[1],
            cover_w=-latent[2],
        )
        temps, mean = self._network.after(boxes.temps, dt_s, loads)
        lag_s = e.sensor_lag * p.sensors.air_lag_s
        follow = -math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0
        sensor = boxes.sensor + follow * (mean[6] - boxes.sensor)
        return replace(boxes, temps=temps, sensor=sensor, fan=speed)

    def _water(self, boxes: BoxStates, dt_s: float, air_m3_s: Floats) -> tuple[Floats, BoxStates]:
        """Heat that water takes from plant, soil and inner sheet [3, B] [W], and the boxes' water after."""
        moisture, soil = self._moisture, self.p.soil
        _, plant_c, soil_c, _, cover_c, _, _ = boxes.temps
        wetness = np.minimum(boxes.soil / (soil.dry_below * soil.water_capacity_kg), 1.0)
        pressure = vapour_pressure(boxes.vapour, self.air(boxes))
        plant_w = moisture.plant_w_kpa * moisture.dark_share * wetness
        plant_w = plant_w * np.maximum(_saturation(plant_c) - pressure, 0.0)
        soil_w = moisture.soil_w_kpa * wetness * np.maximum(_saturation(soil_c) - pressure, 0.0)
        saturated = vapour_density(_saturation(cover_c), cover_c)
        condensed = np.maximum(moisture.film_m3_s * (boxes.vapour - saturated), -boxes.film / dt_s)
        evaporated = (plant_w + soil_w) / EVAPORATION_HEAT
        volume = self.p.box.volume_m3
        rate = air_m3_s / volume
        end = self._room_vapour() + (evaporated - condensed) / volume / rate
        vapour = np.maximum(end + (boxes.vapour - end) * np.exp(-rate * dt_s), 0.0)
        after = replace(
            boxes,
            vapour=vapour,
            film=boxes.film + condensed * dt_s,
            soil=np.maximum(boxes.soil - evaporated * dt_s, 0.0),
        )
        return np.stack([plant_w, soil_w, -condensed * EVAPORATION_HEAT]), after

    def _room_vapour(self) -> float:
        room_c = self._weather.temp_c
        return float(vapour_density(self._weather.vapour_share * saturation_pressure(room_c), room_c))


def _saturation(temp_c: Floats) -> Floats:
    """As `humidity.saturation_pressure`, by arrays [kPa]."""
    return np.asarray(0.6112 * np.exp(17.62 * temp_c / (243.12 + temp_c)))
