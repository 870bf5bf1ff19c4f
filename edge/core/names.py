"""Every signal and actuator once: unit, range, wire field, symbol in the literature; the levels of the
heater.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """One measured quantity."""

    name: str
    unit: str
    key: str  # name at a border: the unit is in it
    low: float  # smallest value the sensor class can report [unit]
    high: float  # largest [unit]
    literature: str  # symbol in the greenhouse literature (GreenLight, Vanthoor 2011), "" where it has none
    label: str
    device_class: str | None = None  # of Home Assistant; None where it has none that fits
    digits: int = 0  # after the point, in Home Assistant; a share is shown in percent


_SIGNALS = (
    Signal("temp_air", "°C", "temp_air_c", -20.0, 80.0, "tAir", "Air temperature", "temperature", 1),
    Signal("temp_ambient", "°C", "temp_ambient_c", -20.0, 60.0, "tOut", "Room temperature", "temperature", 1),
    Signal("rel_humidity", "%", "rel_humidity_pct", 0.0, 100.0, "rhAir", "Relative humidity", "humidity"),
    Signal("co2", "ppm", "co2_ppm", 0.0, 10000.0, "co2Air", "CO2", "carbon_dioxide"),
    Signal("light", "1", "light", 0.0, 1.0, "", "Light (share of full)"),
    Signal("soil_moisture", "1", "soil_moisture", 0.0, 1.0, "", "Soil moisture", "moisture"),
    Signal("tank_level", "1", "tank_level", 0.0, 1.0, "", "Tank level"),
)

SIGNALS: dict[str, Signal] = {signal.name: signal for signal in _SIGNALS}


@dataclass(frozen=True, slots=True)
class Actuator:
    """One driven output."""

    name: str
    unit: str
    key: str
    low: float
    high: float
    step: float  # smallest step the wire can carry [unit]
    label: str


_ACTUATORS = (
    Actuator("heater_duty", "1", "heater_duty", 0.0, 1.0, 0.05, "Heater duty"),
    Actuator("fan_on", "1", "fan_on", 0.0, 1.0, 1.0, "Fan"),
    Actuator("led", "1", "led", 0.0, 1.0, 0.01, "LED light"),
    Actuator("valve_pulse", "s", "valve_pulse_s", 0.0, 10.0, 0.1, "Water valve pulse"),
)

ACTUATORS: dict[str, Actuator] = {actuator.name: actuator for actuator in _ACTUATORS}

HEATER_LEVELS = 20  # the heater duty moves in steps of 1/20 (paper, Modeling)
HEATER_MAX_W = 100.0  # paper, Experimental setup
VOLUME_M3 = 0.5 * 0.5 * 0.6  # paper, Experimental setup


def levels_allowed(max_duty: float) -> int:
    """Highest level (duty * 20) that is not above `max_duty`; 0 when that is not a number."""
    if not max_duty > 0.0:
        return 0
    return int(min(max_duty, 1.0) * HEATER_LEVELS + 1e-9)  # 0.15 * 20 is 3 less a rounding error
