"""Named effects of the fan and of how air moves."""

from collections.abc import Mapping

from edge.twin.effects.effect import (
    DEAD_TIMES_S,
    BlindRuns,
    Effect,
    EffectParameter,
    HiddenBy,
    Offer,
    ParameterKind,
    by_name,
)
from edge.twin.network import AIR, ROOM, Network

_SPEED_STEP = 3e-3  # a fan's speed is rounded (edge/twin/rollout.py): shorter steps of tau_f change nothing


def fan_effectiveness(network: Network, eps_f: float) -> None:
    """Share of the rated flow that changes air, against filters and the box's resistance: F -> eps_f F."""
    network.fan_flow_scale *= eps_f


def short_circuit(network: Network, s_sc: float) -> None:
    """Supply air that leaves before it mixes: F -> (1 - s_sc) F."""
    network.fan_flow_scale *= 1.0 - s_sc


def fan_deadtime(network: Network, d_f: float) -> None:
    """Time until a command acts: F(t) = F_cmd(t - d_f)."""
    network.signals.fan_dead_s = d_f


def fan_spinup(network: Network, tau_f: float) -> None:
    """A rotor that takes time: tau_f ds/dt = u_f - s, F = s F_max."""
    network.signals.fan_lag_s = tau_f


def imperfect_mixing(network: Network, F_mix: float) -> None:
    """Two halves of the air that exchange F_mix: the heater in one, sensor and intake in the other.

    Walls, soil, leaks and other heat have half their share in each.
    """
    network.mixing_m3_s = F_mix


def stirred_loss(network: Network, G_stir: float) -> None:
    """Films that thin in moving air: Q = -u_f G_stir (T - T_amb)."""
    network.connect(AIR, ROOM, 0.0, G_stir)


FLOW_CHECK = "a calibration of the fan's flow by an anemometer"
_VANE = "a tachometer or a vane behind the fan"
_FAN_STEADY = (HiddenBy(BlindRuns.FAN_STEADY),)
AIR_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        fan_effectiveness,
        (EffectParameter("eps_f", "", 0.0, 2.0, 0.8, nothing_at=1.0),),
        source="system effect on a fan's rating, AMCA Publication 201",
        without="positive with the fan on, in proportion to T - T_amb",
        by_flow=True,
        starts=({"eps_f": 0.95},),
        check=FLOW_CHECK,
    ),
    Effect(
        short_circuit,
        (EffectParameter("s_sc", "", 0.0, 1.0, 0.2),),
        source="air change effectiveness, ASHRAE Standard 129",
        without="positive with the fan on, in proportion to T - T_amb",
        by_flow=True,
        starts=({"s_sc": 0.05},),
        check="smoke or a tracer gas that shows where the supply air goes",
    ),
    Effect(
        fan_deadtime,
        (EffectParameter("d_f", "s", 0.0, 600.0, 20.0, ParameterKind.DEAD_TIME),),
        source="transport delay of a first-order-plus-dead-time process, Åström & Hägglund 1995, ch. 2",
        without="positive for one or two rows after the fan goes on in a warm box, "
        "negative after it goes off",
        by_flow=True,
        starts=tuple({"d_f": seconds} for seconds in DEAD_TIMES_S),
        check=_VANE,
        hidden_by=_FAN_STEADY,
    ),
    Effect(
        fan_spinup,
        (EffectParameter("tau_f", "s", 0.5, 600.0, 20.0, ParameterKind.LAG, difference=_SPEED_STEP),),
        source="rotor inertia to first order, ASHRAE HVAC Systems and Equipment 2016, ch. 21",
        without="positive after the fan goes on in a warm box and negative after it goes off, fading",
        by_flow=True,
        starts=({"tau_f": 10.0}, {"tau_f": 40.0}),
        check=_VANE,
        hidden_by=_FAN_STEADY,
    ),
    Effect(
        imperfect_mixing,
        (EffectParameter("F_mix", "m³/s", 1e-4, 1.0, 0.02),),
        source="two-zone model of a room, Sandberg 1981, Building and Environment 16",
        without="the sensor rises late after the heater goes on, "
        "and the fan takes out less heat than it should",
        starts=({"F_mix": 0.004}, {"F_mix": 0.02}, {"F_mix": 0.1}),
        check="a second thermometer in the heater's half of the box",
        common=4,
    ),
    Effect(
        stirred_loss,
        (EffectParameter("G_stir", "W/K", 0.0, 100.0, 2.0),),
        source="forced convection at a wall, Incropera & DeWitt, ch. 7",
        without="negative with the fan on, in proportion to T - T_amb",
        offer=Offer.KNOWN_ONLY,
    ),
)
