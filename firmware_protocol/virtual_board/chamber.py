"""The simulated greenhouse: what the board's pins do to it and what its sensors show.

An independent thermal network with a water and a CO2 balance; CHAMBER.md has the equations and the sources.
Everything is a function of the parameters, the effects, the seed and the inputs.
"""

import copy
import math

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.humidity import (
    Moisture,
    relax,
    saturation_pressure,
    vapour_density,
    vapour_pressure,
)
from firmware_protocol.virtual_board.network import Loads, ThermalNetwork
from firmware_protocol.virtual_board.noise import Wander, uniform
from firmware_protocol.virtual_board.plant import DeadTime, Fan, HeaterSupply
from firmware_protocol.virtual_board.sensors import Sensors
from firmware_protocol.virtual_board.weather import Weather


class DoorSchedule:
    """Openings at random times, of random length."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        self._p, self._seed, self._count = parameters.events, seed, 0
        self._w_k = effects.door_opening * parameters.events.door_w_k
        self._opens_s = self._closes_s = 0.0
        self._next(0.0)

    def _next(self, now_s: float) -> None:
        p = self._p
        wait, length = (uniform(self._seed, stream, self._count) for stream in (30, 31))
        self._count += 1
        self._opens_s = now_s - p.door_interval_s * math.log(wait)
        self._closes_s = self._opens_s + p.door_shortest_s + (p.door_longest_s - p.door_shortest_s) * length

    def conductance(self, now_s: float) -> float:
        """Exchange with the room through the door now [W/K]."""
        if self._w_k <= 0.0:
            return 0.0
        while now_s >= self._closes_s:
            self._next(self._closes_s)
        return self._w_k if now_s >= self._opens_s else 0.0

    def next_change(self, now_s: float) -> float:
        """When the door moves next [s]."""
        if self._w_k <= 0.0:
            return math.inf
        return self._opens_s if now_s < self._opens_s else self._closes_s


MAX_STEP_S = 1.0  # the air's fastest time constant is 6 s
_TINY_S = 1e-6  # above the rounding of time_s after years
_AIR_MOL_M3 = 41.6  # at 20 degC and 1 atm
_SUN_TO_COVER, _SUN_TO_SOIL, _SUN_TO_PLANT = 0.4, 0.4, 0.2  # where the absorbed sun goes
_NODES = ("heater", "plant", "soil", "cover_outer", "cover_inner", "air_upper", "air_lower")
_DEEP_PARTS = ("_weather", "_heater", "_heater_pin", "_fan_pin")  # they hold parts of their own
_FLAT_PARTS = ("_network", "_moisture", "_fan", "_door", "_heat_noise", "_loads", "_sensors")

Inputs = tuple[float, float, float, bool]


class Chamber:
    """The greenhouse at one time.

    parameters, effects: see `chamber_parameters.load`;  seed: of everything random in it
    All nodes start at the room's temperature, with the room's air.
    """

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        self._p, self._e = parameters, effects
        self.time_s = 0.0
        self._waiting_s = 0.0  # time passed that is not yet computed, with constant inputs
        self._inputs: Inputs = (0.0, 0.0, 0.0, False)
        self._weather = Weather(parameters, effects, seed)
        room_c = self._weather.temp_c
        self._network = ThermalNetwork(parameters, effects, room_c)
        self._moisture = Moisture(parameters, effects, self._room_vapour())
        self._heater = HeaterSupply(parameters, effects, seed)
        self._heater_pin = DeadTime(effects.heater_deadtime * parameters.heater.deadtime_s)
        self._fan = Fan(parameters, effects)
        self._fan_pin = DeadTime(effects.fan_deadtime * parameters.fan.deadtime_s)
        self._door = DoorSchedule(parameters, effects, seed)
        self._heat_noise = Wander(seed, 40, parameters.events.heat_noise_tau_s)
        self._loads = Loads(room_c=room_c)
        self.co2_ppm = self._weather.co2_ppm
        self.soil_kg = parameters.soil.water_start * parameters.soil.water_capacity_kg
        self.tank_kg = parameters.tank.start_level * parameters.tank.volume_kg
        self._heater_j = self._led_j = self._other_j = self._latent_j = 0.0
        self._sensors = Sensors(parameters, effects, seed)
        self._sensors.start(room_c, self._rel_humidity_pct(), self.co2_ppm)

    def step(self, dt_s: float, heater_power_fraction: float, fan: bool, led: float, valve: bool) -> None:
        """Let dt_s pass with these inputs [s, 0..1, relay, 0..1, valve open].

        Inputs outside their range are cut to it, NaN is off. Raises ValueError for a dt_s that is negative or
        not finite. Time with the same inputs is computed in steps of 1 s, however finely it is handed in.
        """
        if not 0.0 <= dt_s < math.inf:
            raise ValueError(f"dt_s: {dt_s} is not a length of time")
        inputs = (_share(heater_power_fraction), float(bool(fan)), _share(led), bool(valve))
        if inputs != self._inputs:
            self._catch_up()
            self._inputs = inputs
            self._heater_pin.put(inputs[0], self.time_s)
            self._fan_pin.put(inputs[1], self.time_s)
        self._waiting_s += dt_s
        while self._waiting_s >= MAX_STEP_S:
            self._pass(MAX_STEP_S)
            self._waiting_s -= MAX_STEP_S

    def sense(self) -> dict[str, float]:
        """Return the sensors' present values; keys are the fields of `sensor_report`."""
        self._catch_up()
        soil, tank = self.soil_kg / self._p.soil.water_capacity_kg, self.tank_kg / self._p.tank.volume_kg
        return self._sensors.read(self.time_s, self._weather.temp_c, self._light(), soil, tank)

    def truth(self) -> dict[str, float]:
        """Return the true state: node temperatures [degC], air, water, flows."""
        self._catch_up()
        temps = {f"temp_{name}_c": t for name, t in zip(_NODES, self._network.temps, strict=True)}
        return temps | {
            "time_s": self.time_s,
            "temp_air_c": self._air_c(),
            "temp_sensor_c": self._sensors.air_c,
            "temp_ambient_c": self._weather.temp_c,
            "rel_humidity_pct": self._rel_humidity_pct(),
            "vapour_g_m3": 1000.0 * self._moisture.vapour_kg_m3,
            "co2_ppm": self.co2_ppm,
            "light": self._light(),
            "soil_moisture": self.soil_kg / self._p.soil.water_capacity_kg,
            "tank_level": self.tank_kg / self._p.tank.volume_kg,
            "film_g": 1000.0 * self._moisture.film_kg,
            "heater_w": self._loads.heater_w,
            "radiated_w": self._network.radiated_w,
            "fan_flow_m3_s": self._fan.flow_m3_s,
            "door_open": float(self._door.conductance(self.time_s) > 0.0),
        }

    def energy(self) -> dict[str, float]:
        """Heat since the start [J]: sources in, ways out, stored in the nodes; in = out + stored."""
        self._catch_up()
        network = self._network
        return {
            "heater_in_j": self._heater_j,
            "led_in_j": self._led_j,
            "other_in_j": self._other_j,
            "cover_out_j": network.cover_j,
            "floor_out_j": network.floor_j,
            "air_out_j": network.air_j,
            "latent_out_j": self._latent_j,
            "in_j": self._heater_j + self._led_j + self._other_j,
            "out_j": network.cover_j + network.floor_j + network.air_j + self._latent_j,
            "stored_j": network.stored_j(),
        }

    def copy(self) -> "Chamber":
        """Return an independent copy with the same future."""
        twin = copy.copy(self)
        for name in _DEEP_PARTS:
            setattr(twin, name, getattr(self, name).copy())
        for name in _FLAT_PARTS:
            setattr(twin, name, copy.copy(getattr(self, name)))
        return twin

    def _catch_up(self) -> None:
        if self._waiting_s > _TINY_S:
            self._pass(self._waiting_s)
        self._waiting_s = 0.0

    def _pass(self, dt_s: float) -> None:
        """Let dt_s pass, cut where a dead time ends or the door moves."""
        end_s = self.time_s + dt_s
        while end_s - self.time_s > _TINY_S:
            change_s = min(self._heater_pin.next_change(), self._fan_pin.next_change())
            change_s = min(change_s, self._door.next_change(self.time_s))
            self._advance(max(min(change_s, end_s) - self.time_s, _TINY_S))

    def _advance(self, dt_s: float) -> None:
        """One step with all that acts held constant."""
        middle_s = self.time_s + 0.5 * dt_s
        self._heater_pin.arrive(self.time_s + _TINY_S)
        self._fan_pin.arrive(self.time_s + _TINY_S)
        self._weather.at(middle_s)
        self._fan.step(dt_s, self._fan_pin.value)
        air_m3_s = self._exchange(middle_s)
        self._heat(dt_s, middle_s)
        self._water(dt_s, air_m3_s)
        self._network.step(dt_s, self._loads)
        self._carbon(dt_s, air_m3_s)
        mean = self._network.mean
        self._sensors.step(dt_s, mean[6], self._rel_humidity_pct(), self.co2_ppm, self._network.radiated_w)
        self.time_s += dt_s

    def _exchange(self, now_s: float) -> float:
        """Set the air exchange with the room; returns its flow [m³/s]."""
        air, effects, loads, fan = self._p.air, self._e, self._loads, self._fan
        loads.room_c, loads.draught = self._weather.temp_c, self._weather.draught
        loads.ageing = max(1.0 + effects.ua_drift * self._p.cover.ua_drift_per_day * self._weather.day, 0.1)
        loads.fan_speed = fan.mean_speed
        leak = effects.infiltration * air.leak_flow_m3_s
        if effects.stack_ventilation > 0.0:
            difference = math.sqrt(abs(self._air_c() - loads.room_c))
            leak += effects.stack_ventilation * air.stack_leak_flow_m3_s * difference
        leak *= (1.0 - fan.mean_speed) * loads.ageing
        heat = air.density_kg_m3 * air.heat_capacity_j_kg_k  # per flow [W/K per m³/s]
        door = self._door.conductance(now_s)
        loads.ventilation_w_k = heat * fan.flow_m3_s
        loads.leak_w_k = heat * leak + door
        return fan.flow_m3_s + leak + door / heat

    def _heat(self, dt_s: float, now_s: float) -> None:
        """Set the heat sources of the nodes, without the heat of water."""
        p, effects, loads = self._p, self._e, self._loads
        loads.heater_w = self._heater.power_w(self._heater_pin.value, dt_s, now_s, self._network.temps[0])
        lamp = effects.led_gain * p.led.power_w * self._inputs[2]
        light, sun = lamp * p.led.light_share, self._weather.sun_w
        motor = effects.fan_motor_heat * p.fan.motor_heat_w * loads.fan_speed
        constant = effects.constant_heat * p.events.constant_heat_w
        if effects.heat_noise > 0.0:
            constant += effects.heat_noise * p.events.heat_noise_w * self._heat_noise.at(now_s)
        loads.upper_w = lamp - light + 0.5 * constant
        loads.lower_w = motor + 0.5 * constant
        loads.plant_w = p.led.light_to_plant * light + _SUN_TO_PLANT * sun
        loads.soil_w = p.led.light_to_soil * light + _SUN_TO_SOIL * sun
        loads.cover_w = p.led.light_to_cover * light + _SUN_TO_COVER * sun
        absorbed = lamp - light * (1.0 - p.led.light_to_plant - p.led.light_to_soil - p.led.light_to_cover)
        self._heater_j += dt_s * loads.heater_w
        self._led_j += dt_s * absorbed
        self._other_j += dt_s * (motor + constant + sun)

    def _water(self, dt_s: float, air_m3_s: float) -> None:
        """Water from tank to soil to air to sheet and room, and the heat that goes with it."""
        p, loads = self._p, self._loads
        if self._inputs[3]:
            poured = min(p.tank.valve_flow_kg_s * dt_s, self.tank_kg)
            self.tank_kg -= poured
            self.soil_kg = min(
                self.soil_kg + poured, p.soil.water_capacity_kg
            )  # the rest runs through the pot
        _, plant_c, soil_c, _, cover_c, _, _ = self._network.temps
        # A plant takes water freely until its soil is rather dry, then in proportion.
        wetness = min(self.soil_kg / (p.soil.dry_below * p.soil.water_capacity_kg), 1.0)
        latent = self._moisture.step(
            dt_s,
            plant_c,
            soil_c,
            cover_c,
            self._air_c(),
            self._light(),
            wetness,
            air_m3_s,
            self._room_vapour(),
        )
        self.soil_kg = max(self.soil_kg - latent.evaporated_kg_s * dt_s, 0.0)
        loads.plant_w -= latent.plant_w
        loads.soil_w -= latent.soil_w
        loads.cover_w -= latent.cover_w
        self._latent_j += dt_s * (latent.plant_w + latent.soil_w + latent.cover_w)

    def _carbon(self, dt_s: float, air_m3_s: float) -> None:
        """CO2: respiration, uptake by light (Michaelis and Menten in CO2), exchange."""
        p, volume = self._p, self._p.box.volume_m3
        uptake = p.plant.photosynthesis_mol_s * self._light()
        uptake *= self.co2_ppm / (self.co2_ppm + p.plant.half_saturation_ppm)
        source = (p.plant.respiration_mol_s - uptake) / (volume * _AIR_MOL_M3) * 1e6
        self.co2_ppm = relax(self.co2_ppm, source, air_m3_s / volume, self._weather.co2_ppm, dt_s)

    def _air_c(self) -> float:
        """Mean air temperature."""
        upper, lower = self._network.temps[5:]
        share = self._p.box.heater_zone_share
        mean: float = share * upper + (1.0 - share) * lower
        return mean

    def _light(self) -> float:
        """Light in the box, share of the lamp's full light."""
        return min(self._inputs[2] + self._weather.sun_light, 1.0)

    def _room_vapour(self) -> float:
        room_c = self._weather.temp_c
        density: float = vapour_density(self._weather.vapour_share * saturation_pressure(room_c), room_c)
        return density

    def _rel_humidity_pct(self) -> float:
        """Relative humidity where the sensor is."""
        lower_c = self._network.temps[6]
        pressure: float = vapour_pressure(self._moisture.vapour_kg_m3, lower_c)
        return min(100.0 * pressure / saturation_pressure(lower_c), 100.0)


def _share(value: float) -> float:
    """Cut to 0..1; NaN is 0."""
    return min(value, 1.0) if value > 0.0 else 0.0
