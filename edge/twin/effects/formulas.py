"""Heat that has no name: bounded terms that a twin may carry until its cause is found.

Each is a smooth step over the air's temperature and so stays what it was beyond the data; neither is ever
offered as a name.
"""

from collections.abc import Mapping

import numpy as np

from edge.twin.effects.effect import Effect, EffectParameter, Offer, ParameterKind, by_name
from edge.twin.network import Network
from edge.twin.signals import Floats, HeatConditions

LARGEST_POWER = 40.0  # of e: a step that is as good as whole


def unnamed_heat(network: Network, P_x: float, T_x: float, w_x: float) -> None:
    """Heat of no known cause in a cool box: Q = P_x / (1 + exp((T - T_x) / w_x))."""
    network.heat(lambda now: np.asarray(P_x * (1.0 - _warm(now.temp, T_x, w_x))), by_temp=True)


def unnamed_cut(network: Network, f_x: float, T_x: float, w_x: float) -> None:
    """Share of the heater's heat that a warm box does not get: Q = -f_x H / (1 + exp((T_x - T) / w_x))."""
    full_w = network.geometry.heater_max_w

    def gone(now: HeatConditions) -> Floats:
        return np.asarray(-f_x * full_w * now.column["heater_duty"] * _warm(now.temp, T_x, w_x))

    network.heat(gone, by_temp=True)


def _warm(temp: Floats, middle_c: float, width_k: float) -> Floats:
    """0 in a cool box, 1 in a warm one."""
    away = np.clip((temp - middle_c) / width_k, -LARGEST_POWER, LARGEST_POWER)
    return np.asarray(1.0 / (1.0 + np.exp(-away)))


_TURNING = (
    EffectParameter("T_x", "°C", -20.0, 300.0, 30.0, ParameterKind.TURNING_POINT),
    EffectParameter("w_x", "K", 0.2, 20.0, 1.5),
)
UNNAMED_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        unnamed_heat,
        (EffectParameter("P_x", "W", -200.0, 200.0, 10.0), *_TURNING),
        source="a bounded step, as a neuron of a network has it; stands for what was not found",
        without="positive or negative while the box is cool",
        offer=Offer.NAMELESS,
        stands_in=True,
    ),
    Effect(
        unnamed_cut,
        (EffectParameter("f_x", "", 0.0, 1.0, 0.4), *_TURNING),
        source="a bounded step, as a thermal cut-out makes it; stands for what was not found",
        without="negative in proportion to the duty while the box is warm",
        offer=Offer.NAMELESS,
        stands_in=True,
    ),
)
