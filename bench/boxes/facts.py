"""Facts of a heated box: sizes, materials, heater, fan, sensors and the room around it."""

from dataclasses import dataclass
from typing import Literal

HeaterKind = Literal["wire", "ptc", "ceramic", "tube", "mat"]
FanKind = Literal["exchange", "stir", "none"]


@dataclass(frozen=True, slots=True)
class Material:
    """Thermal properties of a solid."""

    conductivity_w_m_k: float
    density_kg_m3: float
    heat_capacity_j_kg_k: float


# ISO 10456:2007, tables 3 and 4. Twin-wall sheets: mass per area and U-value of a data sheet (teknorm.com,
# "Polycarbonate multiwall sheets"), less 0.17 m² K/W of the films. Soil: wet peat substrate, de Vries 1963.
MATERIALS = {
    "polyethylene film": Material(0.33, 920.0, 2200.0),
    "polycarbonate": Material(0.20, 1200.0, 1200.0),
    "acrylic": Material(0.18, 1180.0, 1500.0),
    "glass": Material(1.00, 2500.0, 750.0),
    "twin-wall": Material(0.050, 200.0, 1200.0),
    "plywood": Material(0.13, 500.0, 1600.0),
    "EPS": Material(0.036, 20.0, 1450.0),
    "XPS": Material(0.034, 35.0, 1450.0),
    "soil": Material(0.50, 900.0, 2600.0),
}


@dataclass(frozen=True, slots=True)
class Layer:
    """A layer of a wall."""

    material: str  # of MATERIALS
    thickness_m: float


@dataclass(frozen=True, slots=True)
class AirSensor:
    """Errors of the sensor of the air, and its place."""

    bias_k: float
    lag_s: float
    step_k: float
    noise_sd_k: float
    high_share: float  # of the upper air in what it feels, 0..1
    wall_share: float  # of the wall in what it feels, 0..1
    element_view: float  # of its surroundings that are the heating element, 0..1


@dataclass(frozen=True, slots=True)
class OtherSensor:
    """Errors of the sensor of the room [K] or of the humidity [%]."""

    bias: float
    step: float
    noise_sd: float


@dataclass(frozen=True, slots=True)
class RoomFacts:
    """The room and the sun in it."""

    mean_c: float
    daily_k: float  # amplitude of the daily sine
    hvac_k: float  # from the lowest to the highest of a cycle
    hvac_period_s: float
    setback_k: float  # colder at night
    drift_k: float  # amplitude of the weather's slow drift
    vapour_kg_m3: float
    start_s: float  # time of day when time is 0
    sunrise_s: float  # time of day when the sun reaches the box
    sunset_s: float
    sun_peak_w_m2: float  # on the window, without clouds; 0: no sun
    mains_share: float  # by which the heater's supply wanders


@dataclass(frozen=True, slots=True)
class BoxFacts:
    """Everything that a box is; its noise and weather also need a seed.

    wall, floor : layers from the inside to the outside; wet soil is the floor's first layer
    """

    seed: int
    kind: str  # of construction, for tables
    length_m: float
    width_m: float
    height_m: float
    wall: tuple[Layer, ...]
    floor: tuple[Layer, ...]
    wall_emissivity_in: float
    wall_emissivity_out: float
    window_m2: float  # of glass or acrylic in the wall; 0: none
    window: Layer
    sunlit_m2: float  # through which the sun shines in
    sun_share: float  # of the sun's power that gets in
    sun_on_wall_share: float  # of the sun on as much of the outer wall that warms the wall
    heater: HeaterKind
    heater_w: float
    element_j_k: float
    element_m2: float
    element_blown_w_k: float  # of a blower of its own
    element_emissivity: float
    plume_share: float  # of the element's convection that reaches the upper air first
    droop_per_k: float  # by which a PTC's power falls above DROOP_FROM_C
    fan: FanKind
    fan_m3_s: float  # exchanged with the room, or stirred
    fan_exchange_share: float  # of an exchanging fan's flow that crosses the box
    fan_w: float
    fan_film_w_m2_k: float  # by which the fan raises the films inside
    fan_leak_m3_s: float  # through gaps, while the fan blows
    leak_m2: float  # of gaps
    contents_j_k: float  # pots, plants, jars of water; 0: none
    contents_m2: float
    wet_share: float  # of the soil that evaporates as open water does
    draught_w_m2_k: float  # by which the room's air raises the outer film
    mixing_m_s: float  # speed at which the two layers of air mix by themselves
    air: AirSensor
    room_sensor: OtherSensor | None
    humidity_sensor: OtherSensor | None
    room: RoomFacts

    @property
    def volume_m3(self) -> float:
        """Inner volume."""
        return self.length_m * self.width_m * self.height_m

    @property
    def floor_m2(self) -> float:
        """Area of the floor."""
        return self.length_m * self.width_m

    @property
    def wall_m2(self) -> float:
        """Area of sides and roof, with the window."""
        return self.floor_m2 + 2.0 * (self.length_m + self.width_m) * self.height_m

    @property
    def has_soil(self) -> bool:
        """Return whether the floor is covered with soil."""
        return self.floor[0].material == "soil"
