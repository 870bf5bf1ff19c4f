"""Named effects beyond the usual ones, which a thermal engineer would look for next."""

from collections.abc import Mapping

import numpy as np

from edge.twin.effects.effect import Effect, EffectParameter, Offer, by_name
from edge.twin.network import AIR, ROOM, Network
from edge.twin.signals import Floats, HeatConditions


def fan_heat(network: Network, P_fan: float) -> None:
    """The motor's heat in the air it moves: Q = P_fan u_f."""
    network.heat(lambda now: P_fan * now.column["fan_on"])


def ground_loss(network: Network, G_g: float, T_g: float) -> None:
    """Heat into what the box stands on, at a temperature of its own: Q = -G_g (T - T_g)."""
    network.connect(AIR, ROOM, G_g)
    network.heat(lambda now: G_g * (T_g - now.ambient))


def stack_ventilation(network: Network, F_st: float) -> None:
    """Air that rises out of leaks, F_st at 10 K: Q = -rho c_p F_st sqrt(|T - T_amb| / 10) (T - T_amb)."""
    leak_w_k = network.geometry.volumetric_heat_j_m3_k * F_st
    _bent_loss(network, leak_w_k, exponent=0.5)


def natural_convection(network: Network, G_nc: float) -> None:
    """A film that thins in a warm box, G_nc at 10 K: Q = -G_nc (|T - T_amb| / 10)^(1/3) (T - T_amb)."""
    _bent_loss(network, G_nc, exponent=1.0 / 3.0)


def _bent_loss(network: Network, at_10_k_w_k: float, exponent: float) -> None:
    """Conductance that grows with a power of the difference; its value at 10 K is part of the network."""
    network.connect(AIR, ROOM, at_10_k_w_k)

    def beyond(now: HeatConditions) -> Floats:
        excess = now.temp - now.ambient
        return np.asarray(at_10_k_w_k * (1.0 - np.abs(excess / 10.0) ** exponent) * excess)

    network.heat(beyond, by_temp=True)


FURTHER_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        fan_heat,
        (EffectParameter("P_fan", "W", 0.0, 100.0, 3.0),),
        source="heat gain of a motor in the airstream, ASHRAE Fundamentals 2017, ch. 18",
        without="positive with the fan on, whatever the temperature",
        offer=Offer.KNOWN_ONLY,
        stands_in=True,
        must_change=("fan_on",),
    ),
    Effect(
        ground_loss,
        (EffectParameter("G_g", "W/K", 0.0, 100.0, 1.0), EffectParameter("T_g", "°C", -10.0, 40.0, 15.0)),
        source="heat transfer via the ground, ISO 13370",
        without="falls with T, and stays where the room warms",
        offer=Offer.KNOWN_ONLY,
    ),
    Effect(
        stack_ventilation,
        (EffectParameter("F_st", "m³/s", 0.0, 0.05, 0.001),),
        source="stack effect through openings, ASHRAE Fundamentals 2017, ch. 16",
        without="falls with the power 1.5 of T - T_amb",
        offer=Offer.KNOWN_ONLY,
    ),
    Effect(
        natural_convection,
        (EffectParameter("G_nc", "W/K", 0.0, 100.0, 3.0),),
        source="turbulent natural convection at a wall, Nu ~ Ra^(1/3), Incropera & DeWitt, ch. 9",
        without="falls with the power 4/3 of T - T_amb",
        offer=Offer.KNOWN_ONLY,
        stands_in=True,
    ),
)
