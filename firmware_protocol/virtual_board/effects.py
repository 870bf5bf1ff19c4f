"""Switches of the chamber: every physical effect has a scale, 0 = absent, 1 = the size in chamber.yaml.

The default of each field is the default set. What scale 0 leaves in an effect's place is said beside it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

# Scales that may be negative: the effect has two signs.
SIGNED = frozenset({"sensor_bias", "sensor_drift", "ambient_offset", "constant_heat", "ua_drift"})
LARGEST_SCALE = 4.0  # the numerics are tested up to here; for more, change the parameter


@dataclass(frozen=True, slots=True)
class Effects:
    """One scale per effect [1]. Raises ValueError for a scale that is not a finite number in its range."""

    # Heat through and into the box (names that the twin knows)
    wall_loss: float = 1.0  # convection outside and floor; 0: none (long-wave loss is its own switch)
    infiltration: float = 1.0  # leak flow while the fan is off
    wall_mass: float = 1.0  # capacity of both sheets; 0: no mass, still a resistance
    soil_mass: float = 1.0  # capacity of the soil; 0: no mass
    extra_capacity: float = 1.0  # things in contact with the air; 0: air alone
    longwave_radiation: float = 1.0  # outer sheet to the room, T^4
    evapotranspiration: float = 1.0  # leaf and soil evaporate
    led_gain: float = 1.0  # heat of the lamp; 0: light without heat
    constant_heat: float = 0.0  # a constant source in the air
    door_opening: float = 0.0  # air exchange in short events; scales the conductance
    ua_drift: float = 1.0  # growth of wall loss and leak per day
    # Heater
    heater_lag: float = 1.0  # the element's heat capacity; 0: no mass
    heater_deadtime: float = 0.0
    heater_efficiency: float = 1.0  # share lost in the supply; 0: none is lost
    radiative_split: float = 1.0  # share of the radiation that reaches surfaces; 0: all heat goes to the air
    heater_saturation: float = 0.0  # cut of the duty's top; 0: u_sat = 1
    heater_sag: float = 0.0
    # Fan and air
    fan_effectiveness: float = 1.0  # 0: the rated flow ventilates fully
    short_circuit: float = 0.0
    fan_deadtime: float = 0.0
    fan_spinup: float = 1.0  # 0: the fan is at speed at once
    imperfect_mixing: float = 1.0  # exchange flow = F_mix / scale; 0: one zone
    # Sensors
    sensor_lag: float = 1.0
    sensor_bias: float = 1.0
    ambient_offset: float = 1.0
    sensor_noise: float = 1.0
    sensor_step: float = 1.0  # 1: quantised; 0: not
    # Disturbances
    ambient_diurnal: float = 1.0
    ambient_wander: float = 1.0
    power_run_variation: float = 1.0  # mains, one factor per run
    power_wander: float = 1.0  # mains, slow within a run
    # In no list: what a real box may have and the twin has no name for
    natural_convection: float = 1.0  # films grow with the temperature difference; 0: constant films
    interior_longwave: float = 1.0  # soil and leaf to the inner sheet
    plant_mass: float = 1.0
    condensation: float = 1.0  # latent heat and water film on the inner sheet
    fan_motor_heat: float = 1.0
    sun_window: float = 0.0  # sun through the room's window on the box
    heater_thermostat: float = 0.0  # the element's own protector derates when hot
    room_draught: float = 0.0  # outer film wanders
    fan_clogging: float = 0.0  # flow falls per day of fan time
    stack_ventilation: float = 0.0  # leak grows with the root of T - T_amb
    sensor_radiation: float = 0.0  # the sensor sees the heater
    sensor_drift: float = 0.0  # per day
    heat_noise: float = 0.0  # coloured heat in the air

    def __post_init__(self) -> None:
        for field in fields(self):
            _check(field.name, getattr(self, field.name))

    @classmethod
    def none(cls, **scales: float) -> "Effects":
        """Every effect absent but those named."""
        return cls(**{name: 0.0 for name in EFFECT_NAMES} | scales)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, float], place: str = "effects") -> "Effects":
        """Return the default set with the named scales. An unknown name is refused with its place."""
        for name in mapping:
            if name not in EFFECT_NAMES:
                raise ValueError(f"{place}: unknown effect '{name}'; known effects: {sorted(EFFECT_NAMES)}")
        return cls(**dict(mapping))


EFFECT_NAMES = tuple(field.name for field in fields(Effects))


def _check(name: str, scale: object) -> None:
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not math.isfinite(scale):
        raise ValueError(f"effects.{name}: {scale!r} is not a finite number")
    lowest = -LARGEST_SCALE if name in SIGNED else 0.0
    if not lowest <= scale <= LARGEST_SCALE:
        raise ValueError(f"effects.{name}: {scale} is outside {lowest:g}..{LARGEST_SCALE:g}")
