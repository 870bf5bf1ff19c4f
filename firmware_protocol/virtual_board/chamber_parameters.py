"""Parameters of the simulated greenhouse, read from chamber.yaml; the unit is in the name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

import yaml

from firmware_protocol.virtual_board.effects import Effects

DEFAULT_FILE = Path(__file__).with_name("chamber.yaml")
Number = Any  # a float, or an array with an element for each box


@dataclass(frozen=True, slots=True, kw_only=True)
class EnclosureParameters:
    """Section `box`: size of the greenhouse, and the heater zone's share of its air."""

    width_m: float
    depth_m: float
    height_m: float
    heater_zone_share: float

    @property
    def volume_m3(self) -> float:
        """Volume of the air; pot and parts are not subtracted [m³]."""
        return self.width_m * self.depth_m * self.height_m

    @property
    def floor_m2(self) -> float:
        """Area of the floor, which is also the area of the roof [m²]."""
        return self.width_m * self.depth_m

    @property
    def cover_m2(self) -> float:
        """Four walls and the roof; the floor stands on the table."""
        return self.floor_m2 + 2.0 * (self.width_m + self.depth_m) * self.height_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Air:
    """Section `air`: heat capacity, flow between the two zones, and leaks."""

    density_kg_m3: float
    heat_capacity_j_kg_k: float
    contact_capacity_factor: float
    mixing_flow_m3_s: float
    fan_mixing_flow_m3_s: float
    leak_flow_m3_s: float
    stack_leak_flow_m3_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Cover:
    """Section `cover`: mass, gap and films of the twin-wall sheet; films hold at `film_reference_k`."""

    areal_mass_kg_m2: float
    heat_capacity_j_kg_k: float
    gap_w_m2_k: float
    inner_film_w_m2_k: float
    inner_film_fan_w_m2_k: float
    outer_film_w_m2_k: float
    film_reference_k: float
    emissivity: float
    draught_share: float
    draught_tau_s: float
    ua_drift_per_day: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Heater:
    """Section `heater`: the ceramic element with its views, its supply and its thermal protector."""

    power_w: float
    capacity_j_k: float
    surface_m2: float
    emissivity: float
    diameter_m: float
    fan_convection_factor: float
    view_cover: float
    view_soil: float
    view_plant: float
    efficiency: float
    deadtime_s: float
    saturation_duty: float
    sag: float
    duty_window_s: float
    thermostat_c: float
    thermostat_share_per_k: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FanParameters:
    """Section `fan`: rated flow, the shares of it that are lost, delays, and heat of the motor."""

    flow_m3_s: float
    effectiveness: float
    short_circuit: float
    spinup_s: float
    deadtime_s: float
    motor_heat_w: float
    clogging_per_day: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Soil:
    """Section `soil`: heat and water of the pot; `water_start` and `dry_below` are shares of its capacity."""

    capacity_j_k: float
    air_w_k: float
    floor_w_k: float
    longwave_m2: float
    evaporation_w_kpa: float
    water_capacity_kg: float
    water_start: float
    dry_below: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParameters:
    """Section `plant`: heat, transpiration and CO2 balance of one plant; respiration includes the soil's."""

    capacity_j_k: float
    leaf_m2: float
    dark_share: float
    film_w_m2_k: float
    transpiration_w_kpa: float
    photosynthesis_mol_s: float
    half_saturation_ppm: float
    respiration_mol_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Led:
    """Section `led`: electric power, its share that is light, and the shares of the light by absorber."""

    power_w: float
    light_share: float
    light_to_plant: float
    light_to_soil: float
    light_to_cover: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Tank:
    """Section `tank`: capacity, share of it at the start, and flow through the open valve."""

    volume_kg: float
    start_level: float
    valve_flow_kg_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """Section `room`: the ambient air's mean, daily swing and noise, and the sun through a window."""

    temp_c: float
    diurnal_k: float
    warmest_hour: float
    wander_sd_k: float
    wander_tau_s: float
    rel_humidity_pct: float
    humidity_wander_pct: float
    humidity_tau_s: float
    co2_ppm: float
    co2_wander_ppm: float
    co2_tau_s: float
    start_hour: float
    start_day: float
    sun_w: float
    sun_from_hour: float
    sun_to_hour: float
    sun_light: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mains:
    """Section `mains`: relative standard deviations of the heater's power, between runs and within one."""

    run_sd: float
    wander_sd: float
    wander_tau_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EventParameters:
    """Section `events`: door openings and heat that no input explains; the default effects use none."""

    door_w_k: float
    door_interval_s: float
    door_shortest_s: float
    door_longest_s: float
    constant_heat_w: float
    heat_noise_w: float
    heat_noise_tau_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorParameters:
    """Section `sensors`: lag, bias, noise (standard deviation), resolution and drift by sensor."""

    air_lag_s: float
    air_bias_k: float
    air_noise_k: float
    temp_step_k: float
    air_drift_k_day: float
    radiation_k_w: float
    ambient_offset_k: float
    ambient_noise_k: float
    humidity_lag_s: float
    humidity_bias_pct: float
    humidity_noise_pct: float
    humidity_step_pct: float
    co2_lag_s: float
    co2_noise_ppm: float
    light_noise: float
    soil_noise: float
    tank_noise: float
    period_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberParameters:
    """All sections of chamber.yaml."""

    box: EnclosureParameters
    air: Air
    cover: Cover
    heater: Heater
    fan: FanParameters
    soil: Soil
    plant: PlantParameters
    led: Led
    tank: Tank
    room: Room
    mains: Mains
    events: EventParameters
    sensors: SensorParameters


# Bounds by name: these may be negative, these are shares of 1, these divide; the rest is 0 or more.
_SIGNED = frozenset(
    {"temp_c", "air_bias_k", "air_drift_k_day", "ambient_offset_k", "humidity_bias_pct", "constant_heat_w",
     "ua_drift_per_day", "start_day", "thermostat_c"}
)  # fmt: skip
_SHARES = frozenset(
    {"dark_share", "light_share", "light_to_plant", "light_to_soil", "light_to_cover", "emissivity",
     "efficiency", "effectiveness", "short_circuit", "saturation_duty", "water_start", "start_level",
     "draught_share", "sun_light"}
)  # fmt: skip
_DIVISORS = frozenset(
    {"width_m", "depth_m", "height_m", "density_kg_m3", "heat_capacity_j_kg_k", "mixing_flow_m3_s",
     "gap_w_m2_k", "inner_film_w_m2_k", "film_reference_k", "surface_m2", "diameter_m", "leaf_m2",
     "film_w_m2_k", "air_w_k", "view_cover", "water_capacity_kg", "volume_kg", "half_saturation_ppm",
     "period_s", "temp_step_k", "humidity_step_pct", "dry_below", "door_interval_s"}
)  # fmt: skip
_SMALLEST = 1e-9
_LARGEST = 1e9


def _bounds(name: str) -> tuple[float, float]:
    """Smallest and largest value of a key."""
    if name == "heater_zone_share":
        return 0.05, 0.95
    if name in _SIGNED:
        return -_LARGEST, _LARGEST
    low = _SMALLEST if name in _DIVISORS or name.endswith("_tau_s") else 0.0
    return low, 1.0 if name in _SHARES else _LARGEST


def load(path: Path | None = None) -> tuple[ChamberParameters, Effects]:
    """Load the default parameters and effects, changed by the file at `path`.

    A value is a number or `{value: number, source: text}`. Raises ValueError, which names file, section
    and key, for an unknown key, a value that is not a number or one outside its range.
    """

    sections = _read(DEFAULT_FILE) | {"effects": {}}
    if path is not None:
        changes = _read(path)
        _refuse_unknown(changes, sections, path.name)
        for name, section in changes.items():
            if name != "effects":
                _refuse_unknown(section, sections[name], f"{path.name}.{name}")
            sections[name] = sections[name] | section
    file = DEFAULT_FILE.name if path is None else path.name
    effects = Effects.from_mapping(sections.pop("effects"), f"{file}.effects")
    return from_sections(sections, file), effects


def from_sections(sections: Mapping[str, Mapping[str, Any]], place: str) -> ChamberParameters:
    """Return checked parameters from `{section: {key: value}}`, all sections and keys present."""
    types = get_type_hints(ChamberParameters)
    return ChamberParameters(
        **{name: _section(types[name], sections[name], f"{place}.{name}") for name in types}
    )


def _read(path: Path) -> dict[str, dict[str, Any]]:
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (RecursionError, yaml.YAMLError) as error:
        raise ValueError(f"{path.name}: {error}") from error
    if not isinstance(raw, dict) or not all(isinstance(section, dict) for section in raw.values()):
        raise ValueError(f"{path.name}: not a mapping of sections")
    return {name: {key: _bare(value) for key, value in section.items()} for name, section in raw.items()}


def _bare(value: object) -> object:
    return value["value"] if isinstance(value, dict) and "value" in value else value


def _refuse_unknown(given: Mapping[str, Any], known: Mapping[str, Any], place: str) -> None:
    for key in given:
        if key not in known:
            raise ValueError(f"{place}: unknown key '{key}'; known keys: {sorted(known)}")


def _section(section_type: type, values: Mapping[str, Any], place: str) -> Any:
    names = [field.name for field in fields(section_type)]
    _refuse_unknown(values, dict.fromkeys(names), place)
    for name in names:
        if name not in values:
            raise ValueError(f"{place}: missing key '{name}'")
        _check(name, values[name], f"{place}.{name}")
    return section_type(**{name: float(values[name]) for name in names})


def _check(name: str, value: object, place: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{place}: {value!r} is not a finite number")
    low, high = _bounds(name)
    if not low <= value <= high:
        raise ValueError(f"{place}: {value} is outside {low:g}..{high:g}")
