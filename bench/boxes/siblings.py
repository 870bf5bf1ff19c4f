"""Boxes that are built alike: one design, the tolerances of its parts, and a room of its own for each.

Tolerances: heaters +5 % to -10 % of their rating (IEC 60335-1, clause 10); flow of fans, sheets and soil as a
careful hand builds them; plants and water as people fill them. A person describes all of them as the design.
"""

from dataclasses import replace

import numpy as np

from bench.boxes.draw import draw_room
from bench.boxes.facts import AirSensor, BoxFacts, Layer
from bench.boxes.lots import Hand

SALT = 7
HEATER, FLOW, SHEET, SOIL = (0.90, 1.05), (0.85, 1.15), (0.93, 1.07), (0.8, 1.25)
SUN = 0.3, 1.5  # times that of the design: each box has a window of its own
GAPS, WATER, LAG = (0.5, 2.0), (0.6, 1.7), (0.8, 1.25)
BIAS_K, SHARE = 0.5, 0.1  # of the air's sensor; by which its place differs


def sibling(design: BoxFacts, number: int) -> BoxFacts:
    """Build a design once more, in a room of its own. number : of the box, 1 or more"""
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
        air=_air_sensor(design.air, hand),
    )


def _layers(layers: tuple[Layer, ...], hand: Hand) -> tuple[Layer, ...]:
    return tuple(
        replace(
            layer, thickness_m=layer.thickness_m * hand.even(*(SOIL if layer.material == "soil" else SHEET))
        )
        for layer in layers
    )


def _air_sensor(sensor: AirSensor, hand: Hand) -> AirSensor:
    return replace(
        sensor,
        bias_k=hand.even(-BIAS_K, BIAS_K),
        lag_s=sensor.lag_s * hand.even(*LAG),
        high_share=float(np.clip(sensor.high_share + hand.even(-SHARE, SHARE), 0.0, 1.0)),
        wall_share=float(np.clip(sensor.wall_share + hand.even(-0.5 * SHARE, 0.5 * SHARE), 0.0, 0.3)),
    )
