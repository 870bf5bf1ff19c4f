"""python -m bench.boxes.draw: draw heated boxes from seeds, and print those that are used."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import AirSensor, BoxFacts, HeaterKind, Layer, OtherSensor, RoomFacts
from bench.boxes.lots import (
    CLEAR,
    CONSTRUCTIONS,
    FANS,
    HUMIDITY_SENSORS,
    HVACS,
    LIGHT,
    LOT,
    MAT_W_M2,
    MIDDLE,
    POWERS_W,
    RISES_K,
    ROOM_SENSORS,
    STEPS_K,
    SUNS,
    Hand,
    deal_lot,
)
from bench.boxes.physics import BoxPhysics
from bench.boxes.rates import ZERO_C, saturated_g_m3

Floats = NDArray[np.float64]
REFERENCE_SHARES = (
    0.15,
    0.80,
)  # of the rise, so that power is left to follow it
HOTTEST_C = 38.0  # 2 K below temp_air_max_c, at which the daemon ends all heating
QUICK, NEARLY = 1.0 - np.exp(-1.0), 0.95  # shares of the rise
SALT = 7
HEATER, FLOW, SHEET, SOIL = (0.90, 1.05), (0.85, 1.15), (0.93, 1.07), (0.8, 1.25)
SUN = 0.3, 1.5  # times that of the design: each box has another window
GAPS, WATER, LAG = (0.5, 2.0), (0.6, 1.7), (0.8, 1.25)
BIAS_K, SHARE = 0.5, 0.1  # of the air's sensor; by which its place differs


@dataclass(frozen=True, slots=True)
class Still:
    """A room that stays as it is, without sun."""

    room_c: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the room [°C], no sun, and nominal mains."""
        return self.room_c, 0.0, 1.0


@dataclass(frozen=True, slots=True)
class Reach:
    """Air of a box at rest in its mean room, and the way there at full power."""

    zero_c: float  # without heat
    full_c: float  # at full power
    fan_c: float  # at full power while the fan blows
    quick_s: float  # until 63 % of the rise
    slow_s: float  # until 95 %

    @property
    def rise_k(self) -> float:
        """By which full power warms the air."""
        return self.full_c - self.zero_c


@lru_cache(maxsize=64)
def reach(facts: BoxFacts) -> Reach:
    """Return the reach of a box in a still room at its mean temperature."""
    room_c = facts.room.mean_c
    physics = BoxPhysics(facts, Still(room_c))
    zero_c, fan_c = (
        float(physics.air_c(physics.rest(room_c, *inputs))[0]) for inputs in ((0.0, 0.0), (1.0, 1.0))
    )
    times, states = physics.warm_up(room_c, 1.0)
    air = physics.air_c(states)
    rise = air - air[0]
    quick_s, slow_s = (float(times[np.argmax(rise >= share * rise[-1])]) for share in (QUICK, NEARLY))
    return Reach(zero_c, float(air[-1]), fan_c, quick_s, slow_s)


def rise_k(facts: BoxFacts) -> float:
    """Return by how much full power without the fan warms the air over the room."""
    room_c = facts.room.mean_c
    physics = BoxPhysics(facts, Still(room_c))
    return float(physics.air_c(physics.rest(room_c, 1.0))[0] - room_c)


def rise_after_k(facts: BoxFacts, hours: float) -> float:
    """Return by how much full power without the fan warms the air within hours, from rest [K]."""
    physics = BoxPhysics(facts, Still(facts.room.mean_c))
    times, states = physics.warm_up(facts.room.mean_c, 1.0)
    air = physics.air_c(states)
    return float(np.interp(3600.0 * hours, times, air - air[0]))


def scaled_reference(reference_k01: Floats, facts: BoxFacts) -> Floats:
    """Return a course 0..1 [N] as a reference that this box can follow [°C].

    0 becomes 15 % of the box's rise over its mean room, and 1 becomes 80 %, but at most HOTTEST_C.
    """
    low, high = REFERENCE_SHARES
    high = min(high, (HOTTEST_C - facts.room.mean_c) / reach(facts).rise_k)
    share = low + (high - low) * np.asarray(reference_k01, dtype=np.float64)
    return np.asarray(facts.room.mean_c + share * reach(facts).rise_k)


__all__ = ["DEVELOPMENT", "LOTS", "SCORED", "BoxFacts", "draw_box"]

LOTS = tuple(tuple(range(first, first + LOT)) for first in (1, 101, 201, 301, 401, 501, 601))
BURNT = 9  # boxes of the third lot; they and lots 2, 4 and 5 were scored once, lot 6 as designs of fleets
DEVELOPMENT = (*LOTS[0], *LOTS[1], *LOTS[2][:BURNT], *LOTS[3], *LOTS[4], *LOTS[5])
SCORED = (*LOTS[2][BURNT:], *LOTS[6])
FLOWS_M3_H = (5.0, 200.0)
CHANGES_1_MIN = (0.8, 5.0)  # of the air by the fan
WATER_KG_M2 = ((0.2, 2.0), (2.0, 10.0), (5.0, 40.0))  # in pots, plants and jars on the floor, by weight
WATER_J_KG_K = 4186.0
SWING_K = 8.0
SUN_W_M2 = 700.0  # behind a window, about noon
LEAST_LAG_S = 3.0  # of a sensor; a shorter one is none
ATTEMPTS = 50  # at a box that no heater suits
SIZINGS = 6  # rounds, until the heater suits within 1 %
ELEMENT_W_M2 = {"ptc": 3000.0, "ceramic": 4500.0, "tube": 900.0}  # heat flux of the hot surface
ELEMENT_OVER_K = {"ptc": 70.0, "ceramic": 190.0, "tube": 60.0}  # over the air at full power, roughly
ELEMENT_LAGS_S = {"ptc": (20.0, 90.0), "ceramic": (120.0, 480.0), "tube": (240.0, 600.0)}


@lru_cache(maxsize=64)
def draw_box(seed: int) -> BoxFacts:
    """Draw the box of a seed, 1 or more."""
    if seed < 1:
        raise ValueError(f"bench.boxes: seed {seed} is below 1")
    hand = Hand(seed)
    for _ in range(ATTEMPTS):
        wished_k = RISES_K[0] + (RISES_K[1] - RISES_K[0]) * hand.fifteenth("rise", 0.0, 1.0) ** 1.4
        if (facts := _size_heater(_draw(seed, hand), wished_k, hand)) is not None:
            return facts
    raise RuntimeError(f"bench.boxes: no heater of {POWERS_W} W suits the box of seed {seed}")


def _draw(seed: int, hand: Hand) -> BoxFacts:
    """Draw everything but the size of the heater."""
    # Numbers are drawn in the order of the lines, so a new line belongs at the end, or all boxes change.
    lot = deal_lot(hand.lot)
    build, heater = lot.constructions[hand.place], lot.heaters[hand.place]
    volume_m3 = lot.volumes_m3[hand.place]
    kind, layers, has_soil = CONSTRUCTIONS[build]
    edge_m = volume_m3 ** (1.0 / 3.0)
    length_m, width_m = edge_m * hand.log(0.8, 1.4), edge_m * hand.log(0.75, 1.1)
    height_m = volume_m3 / (length_m * width_m)
    base_m2 = length_m * width_m
    area_m2 = base_m2 + 2.0 * (length_m + width_m) * height_m
    is_clear = layers[0][0] in CLEAR
    window_m2 = 0.0 if is_clear else hand.even(0.08, 0.25) * area_m2
    weight = 0 if build < LIGHT else 1 if build < MIDDLE else 2
    water_kg = hand.log(*WATER_KG_M2[weight]) * base_m2
    fan = FANS[hand.rank("fan")]
    flow_m3_h = (
        float(np.clip(60.0 * volume_m3 * hand.log(*CHANGES_1_MIN), *FLOWS_M3_H)) if fan != "none" else 0.0
    )
    return BoxFacts(
        seed=seed,
        kind=kind,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        wall=tuple(Layer(*layer) for layer in layers),
        floor=_floor(hand, layers, has_soil, weight, height_m),
        wall_emissivity_in=0.2 if kind.startswith(("EPS", "XPS")) and hand.even() < 0.5 else 0.9,
        wall_emissivity_out=0.6 if "film" in kind else 0.9,  # thin film lets some of the radiation through
        window_m2=window_m2,
        window=Layer("glass" if hand.even() < 0.5 else "acrylic", 0.003),
        sunlit_m2=window_m2 or 0.25 * area_m2,
        sun_share=hand.even(0.55, 0.8),
        sun_on_wall_share=hand.even(0.05, 0.2) if is_clear else 0.0,
        heater=heater,
        heater_w=0.0,
        element_j_k=0.0,
        element_m2=0.0,
        element_blown_w_k=0.0,
        element_emissivity=0.95 if heater == "ceramic" else 0.85,
        plume_share=hand.even(0.2, 0.8),
        droop_per_k=hand.even(0.002, 0.008) if heater == "ptc" else 0.0,
        fan=fan,
        fan_m3_s=flow_m3_h / 3600.0,
        fan_exchange_share=hand.even(0.5, 0.95),
        fan_w=0.0 if fan == "none" else 0.5 + 0.03 * flow_m3_h,
        fan_film_w_m2_k={"exchange": hand.even(1.0, 4.0), "stir": hand.even(4.0, 12.0), "none": 0.0}[fan],
        fan_leak_m3_s=(hand.even(0.02, 0.08) if fan == "stir" else 0.0) * flow_m3_h / 3600.0,
        leak_m2=area_m2 * hand.log(0.3e-4, 5e-4),
        contents_j_k=water_kg * WATER_J_KG_K,
        contents_m2=0.1 * water_kg ** (2.0 / 3.0),
        wet_share=hand.even(0.1, 0.7) if has_soil else 0.0,
        draught_w_m2_k=hand.even(0.3, 2.5),
        mixing_m_s=hand.log(0.003, 0.02),
        air=_air_sensor(hand, heater),
        room_sensor=_other_sensor(hand, 0.5) if ROOM_SENSORS[hand.rank("room sensor")] else None,
        humidity_sensor=_other_sensor(hand, 4.0) if HUMIDITY_SENSORS[hand.rank("humidity")] else None,
        room=draw_room(hand),
    )


def _floor(
    hand: Hand, layers: tuple[tuple[str, float], ...], has_soil: bool, weight: int, height_m: float
) -> tuple[Layer, ...]:
    """Soil, as deep as fits, on a base as good as the wall."""
    depth_m = min(hand.even(0.03, 0.06) if weight < 2 else hand.even(0.05, 0.12), 0.25 * height_m)
    soil = (Layer("soil", depth_m),) if has_soil else ()
    bases = (("plywood", 0.009), ("EPS", 0.02), ("twin-wall", 0.010))
    base = ("XPS", 0.03) if len(layers) > 1 or layers[0][0] in ("EPS", "XPS") else bases[hand.rng.integers(3)]
    return (*soil, Layer(*base))


def _air_sensor(hand: Hand, heater: HeaterKind) -> AirSensor:
    step_k = STEPS_K[hand.rank("steps")]
    lag_s = max(hand.fifteenth("lag", -20.0, 120.0), 0.0)  # two boxes in fifteen have none
    view = hand.even(0.0, 0.006) if heater in ("ceramic", "tube") else 0.0
    return AirSensor(
        bias_k=hand.even(-0.5, 0.5),
        lag_s=lag_s if lag_s > LEAST_LAG_S else 0.0,
        step_k=step_k,
        noise_sd_k=hand.log(0.01, 0.1),
        high_share=hand.even(),
        wall_share=hand.even(0.0, 0.25),
        element_view=view,
    )


def _other_sensor(hand: Hand, bias: float) -> OtherSensor:
    """Draw a sensor of the room or of the humidity, with errors in proportion to its bias."""
    return OtherSensor(hand.even(-bias, bias), bias * float(hand.rng.choice([0.02, 0.125, 0.2])), 0.1 * bias)


def draw_room(hand: Hand) -> RoomFacts:
    """Swings of the room, of several kinds, that together reach up to SWING_K."""
    swing_k = hand.fifteenth("swing", 0.6, SWING_K)
    shares = hand.rng.dirichlet([2.0, 1.0, 1.0, 1.0])
    if not HVACS[hand.rank("hvac")]:
        shares[1] = 0.0
    daily_k, hvac_k, setback_k, drift_k = swing_k * shares
    mean_c = hand.even(13.0, 24.0)
    sunrise_s = 3600.0 * hand.even(7.0, 12.0)
    return RoomFacts(
        mean_c=mean_c,
        daily_k=0.5 * daily_k,
        hvac_k=min(hvac_k, 3.0),
        hvac_period_s=60.0 * hand.log(12.0, 90.0),
        setback_k=setback_k,
        drift_k=0.5 * drift_k,
        vapour_kg_m3=1e-3 * hand.even(0.35, 0.6) * float(saturated_g_m3(np.array([mean_c + ZERO_C]))[0]),
        start_s=hand.even(0.0, 86_400.0),
        sunrise_s=sunrise_s,
        sunset_s=sunrise_s + 3600.0 * hand.even(2.5, 6.0),
        sun_peak_w_m2=hand.even(0.1, 0.5) if SUNS[hand.rank("sun")] else 0.0,  # a share of the heater so far
        mains_share=hand.even(0.0, 0.03),
    )


def _size_heater(facts: BoxFacts, wished_k: float, hand: Hand) -> BoxFacts | None:
    """Return the box with a heater that warms it as wished; None where no heater of POWERS_W comes near."""
    lag_s = hand.even(*ELEMENT_LAGS_S.get(facts.heater, (0.0, 0.0)))
    power_w = 60.0
    most_w = min(POWERS_W[1], MAT_W_M2 * facts.floor_m2 if facts.heater == "mat" else math.inf)
    for _ in range(SIZINGS):
        sized = _with_heater(facts, power_w, lag_s)
        rise = rise_k(sized)
        if rise <= 0.0:
            return None
        power_w = float(np.clip(power_w * (wished_k / rise) ** 1.1, POWERS_W[0], most_w))
    if not RISES_K[0] <= rise <= RISES_K[1] + 1.0:
        return None
    gain_w = facts.room.sun_peak_w_m2 * sized.heater_w
    peak = min(gain_w / (facts.sunlit_m2 * facts.sun_share), SUN_W_M2)
    return replace(sized, room=replace(facts.room, sun_peak_w_m2=peak))


def _with_heater(facts: BoxFacts, power_w: float, lag_s: float) -> BoxFacts:
    """Return the box with an element in proportion to its power."""
    if facts.heater in ("wire", "mat"):
        return replace(facts, heater_w=power_w)
    over_k = ELEMENT_OVER_K[facts.heater]
    return replace(
        facts,
        heater_w=power_w,
        element_m2=power_w / ELEMENT_W_M2[facts.heater],
        element_j_k=lag_s * power_w / over_k,
        element_blown_w_k=0.8 * power_w / over_k if facts.heater == "ptc" else 0.0,
    )


def table(seeds: Sequence[int] = (*DEVELOPMENT, *SCORED)) -> list[str]:
    """Return the lines of a table of these boxes, of all that are used, 80 columns wide."""
    head = "                litres heater    W fan m3/h rise  fan 63 %  95 % room none"
    units = "                                              K    K  min     h   C"
    return [head, units, *(_row(draw_box(seed)) for seed in seeds)]


def _row(facts: BoxFacts) -> str:
    far = reach(facts)
    fan = f"{facts.fan[:4]} {3600.0 * facts.fan_m3_s:3.0f}" if facts.fan != "none" else ""
    sensors = {"room": facts.room_sensor, "damp": facts.humidity_sensor}
    absent = [name for name, sensor in sensors.items() if sensor is None]
    return (
        f"{facts.seed:3d} {facts.kind:15s} {1000 * facts.volume_m3:3.0f} {facts.heater:7s} "
        f"{facts.heater_w:3.0f} {fan:8s} {far.rise_k:4.1f} {far.fan_c - far.zero_c:4.1f} "
        f"{far.quick_s / 60.0:4.0f} {far.slow_s / 3600.0:5.1f} {facts.room.mean_c:4.0f} "
        f"{'both' if len(absent) == 2 else ''.join(absent)}".rstrip()
    )


def sibling(design: BoxFacts, number: int) -> BoxFacts:
    """Build a design once more, in another room. number : of the box, 1 or more"""
    seed = 1000 * design.seed + number
    hand = Hand(seed)
    hand.rng = np.random.default_rng([seed, SALT])
    heat = hand.even(*HEATER)
    room = draw_room(hand)
    sun_w_m2 = design.room.sun_peak_w_m2 * hand.even(*SUN)
    return replace(
        design,
        seed=seed,
        room=replace(room, sun_peak_w_m2=sun_w_m2),
        wall=_layers(design.wall, hand),
        floor=_layers(design.floor, hand),
        heater_w=design.heater_w * heat,
        element_blown_w_k=design.element_blown_w_k * heat,
        fan_m3_s=design.fan_m3_s * hand.even(*FLOW),
        leak_m2=design.leak_m2 * hand.log(*GAPS),
        contents_j_k=design.contents_j_k * hand.log(*WATER),
        wet_share=design.wet_share * hand.even(0.5, 1.2),
        draught_w_m2_k=hand.even(0.3, 2.5),
        mixing_m_s=design.mixing_m_s * hand.log(0.8, 1.25),
        air=_same_air_sensor(design.air, hand),
    )


def _layers(layers: tuple[Layer, ...], hand: Hand) -> tuple[Layer, ...]:
    return tuple(
        replace(
            layer, thickness_m=layer.thickness_m * hand.even(*(SOIL if layer.material == "soil" else SHEET))
        )
        for layer in layers
    )


def _same_air_sensor(sensor: AirSensor, hand: Hand) -> AirSensor:
    return replace(
        sensor,
        bias_k=hand.even(-BIAS_K, BIAS_K),
        lag_s=sensor.lag_s * hand.even(*LAG),
        high_share=float(np.clip(sensor.high_share + hand.even(-SHARE, SHARE), 0.0, 1.0)),
        wall_share=float(np.clip(sensor.wall_share + hand.even(-0.5 * SHARE, 0.5 * SHARE), 0.0, 0.3)),
    )


if __name__ == "__main__":
    print("\n".join(table()))
