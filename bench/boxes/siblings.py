"""Boxes that are built alike: one design, the tolerances of its parts, and a room of its own for each.

Tolerances: heaters +5 % to -10 % of their rating (IEC 60335-1, clause 10); flow of fans, sheets and soil as a
careful hand builds them; plants and water as people fill them. A person describes all of them as the design.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from bench.boxes.draw import draw_room
from bench.boxes.facts import AirSensor, BoxFacts, Layer
from bench.boxes.lots import Hand

SALT = 7
HEATER, FLOW, SHEET, SOIL = (0.90, 1.05), (0.85, 1.15), (0.93, 1.07), (0.8, 1.25)
SUN = 0.3, 1.5  # times that of the design: each box has a window of its own
GAPS, WATER, LAG = (0.5, 2.0), (0.6, 1.7), (0.8, 1.25)
BIAS_K, SHARE = 0.5, 0.1  # of the air's sensor; by which its place differs


class Draws(Protocol):
    """Source of the tolerances of a box."""

    def even(self, low: float, high: float) -> float:
        """Draw evenly."""
        ...

    def log(self, low: float, high: float) -> float:
        """Draw evenly in the logarithm."""
        ...


def sibling(design: BoxFacts, number: int, odd: str = "") -> BoxFacts:
    """Build a design once more. number : of the box, 1 or more; odd : of ODD, what is not as designed"""
    seed = 1000 * design.seed + number
    hand = Hand(seed)
    hand.rng = np.random.default_rng([seed, SALT])
    heat = hand.even(*HEATER)
    room = draw_room(hand)
    sun_w_m2 = design.room.sun_peak_w_m2 * hand.even(*SUN)
    built = replace(build(design, heat, hand), seed=seed, room=replace(room, sun_peak_w_m2=sun_w_m2))
    return ODD[odd](built) if odd else built


def build(design: BoxFacts, heat: float, draws: Draws) -> BoxFacts:
    """Build a design in its own room. heat : of the heater, 1: as it is rated"""
    return replace(
        design,
        wall=_layers(design.wall, draws),
        floor=_layers(design.floor, draws),
        heater_w=design.heater_w * heat,
        element_blown_w_k=design.element_blown_w_k * heat,
        fan_m3_s=design.fan_m3_s * draws.even(*FLOW),
        leak_m2=design.leak_m2 * draws.log(*GAPS),
        contents_j_k=design.contents_j_k * draws.log(*WATER),
        wet_share=design.wet_share * draws.even(0.5, 1.2),
        draught_w_m2_k=draws.even(0.3, 2.5),
        mixing_m_s=design.mixing_m_s * draws.log(0.8, 1.25),
        air=_air_sensor(design.air, draws),
    )


def _layers(layers: tuple[Layer, ...], draws: Draws) -> tuple[Layer, ...]:
    return tuple(
        replace(
            layer, thickness_m=layer.thickness_m * draws.even(*(SOIL if layer.material == "soil" else SHEET))
        )
        for layer in layers
    )


def _air_sensor(sensor: AirSensor, draws: Draws) -> AirSensor:
    return replace(
        sensor,
        bias_k=draws.even(-BIAS_K, BIAS_K),
        lag_s=sensor.lag_s * draws.even(*LAG),
        high_share=float(np.clip(sensor.high_share + draws.even(-SHARE, SHARE), 0.0, 1.0)),
        wall_share=float(np.clip(sensor.wall_share + draws.even(-0.5 * SHARE, 0.5 * SHARE), 0.0, 0.3)),
    )


def _thicker(layers: tuple[Layer, ...], factor: float) -> tuple[Layer, ...]:
    return tuple(replace(layer, thickness_m=factor * layer.thickness_m) for layer in layers)


ODD: Mapping[str, Callable[[BoxFacts], BoxFacts]] = {
    "lid ajar": lambda facts: replace(facts, leak_m2=8.0 * facts.leak_m2),
    "weaker heater": lambda facts: replace(facts, heater_w=0.6 * facts.heater_w),
    "thinner wall": lambda facts: replace(facts, wall=_thicker(facts.wall, 0.5)),
    "insulated": lambda facts: replace(facts, wall=(*facts.wall, Layer("EPS", 0.02))),
    "full of water": lambda facts: replace(facts, contents_j_k=4.0 * facts.contents_j_k),
    "slow sensor": lambda facts: replace(facts, air=replace(facts.air, lag_s=facts.air.lag_s + 150.0)),
}
