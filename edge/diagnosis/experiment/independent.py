"""What would tell of an effect without heater and fan: a measurement that a person can make."""

from collections.abc import Iterable, Mapping

from edge.twin.twin_file import Place

FLOW = "a calibration of the fan's flow by an anemometer"
POWER = "a power meter at the heater's plug"
AIR_PROBE = "a calibrated thermometer beside the air sensor"
ROOM_PROBE = "an independent room sensor"
CHECKS: Mapping[str, str] = {
    "fan_effectiveness": FLOW,
    "short_circuit": "smoke or a tracer gas that shows where the supply air goes",
    "fan_deadtime": "a tachometer or a vane behind the fan",
    "fan_spinup": "a tachometer or a vane behind the fan",
    "imperfect_mixing": "a second thermometer in the heater's half of the box",
    "sensor_lag": "a fast thermocouple beside the air sensor",
    "sensor_bias": AIR_PROBE,
    "ambient_offset": ROOM_PROBE,
    "constant_heat": "a power meter on all else that runs in the box",
    "heater_lag": "a thermocouple on the heater's element",
    "heater_deadtime": POWER,
    "heater_efficiency": POWER,
    "heater_saturation": POWER,
    "heater_sag": POWER,
    "radiative_split": "an infrared thermometer on the walls while the heater is on",
    "wall_loss": "a heat flux plate on the wall",
    "wall_mass": "a thermometer on the wall",
    "longwave_radiation": "a foil with low emissivity on the outside for a run",
    "soil_mass": "a thermometer in the soil, or a run without the pots",
    "extra_capacity": "a run with the box emptied",
    "infiltration": "a run with the fan's openings taped",
    "led_gain": "a power meter at the lamp",
    "solar_gain": "a day with the windows covered",
    "evapotranspiration": "a run without plant and wet soil",
    "door_opening": "a contact on the door",
    "ua_drift": "the same run again after some days",
}
GEOMETRY: Mapping[str, str] = {
    "heater_max_w": POWER,
    "fan_max_m3_s": FLOW,
    "volume_m3": "a tape measure",
    "air_density_kg_m3": "a barometer",
    "air_heat_capacity_j_kg_k": "a hygrometer",
}


def checks(names: Iterable[str]) -> tuple[str, ...]:
    """What would tell of these effects, each once."""
    return tuple(dict.fromkeys(CHECKS[name] for name in names if name in CHECKS))


def calibration(place: Place) -> str:
    """How a value is calibrated."""
    table, key = (GEOMETRY, place[1]) if place[0] == "geometry" else (CHECKS, place[1])
    return table.get(key, "a measurement of its own")
