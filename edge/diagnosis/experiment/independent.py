"""Independent checks of an effect: measurements that a person can make without heater and fan."""

from collections.abc import Iterable, Mapping

from edge.twin.effects.air import FLOW_CHECK
from edge.twin.effects.heater import POWER_CHECK
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import Place

GEOMETRY: Mapping[str, str] = {
    "heater_max_w": POWER_CHECK,
    "fan_max_m3_s": FLOW_CHECK,
    "volume_m3": "a tape measure",
    "air_density_kg_m3": "a barometer",
    "air_heat_capacity_j_kg_k": "a hygrometer",
}


def checks(names: Iterable[str]) -> tuple[str, ...]:
    """Return the independent checks of these effects, each once."""
    return tuple(dict.fromkeys(check for name in names if (check := EFFECTS[name].check)))


def calibration(place: Place) -> str:
    """How a value is calibrated."""
    check = GEOMETRY.get(place[1], "") if place[0] == "geometry" else EFFECTS[place[1]].check
    return check or "a measurement of its own"
