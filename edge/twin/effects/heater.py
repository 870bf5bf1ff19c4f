"""Named effects between the heater's command and heat in the box."""

from collections.abc import Mapping

import numpy as np

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
from edge.twin.network import Network
from edge.twin.signals import Floats, HeatConditions

RATED_AT_C = 20.0  # a rated power is that in a room


def heater_lag(network: Network, tau_h: float) -> None:
    """The element warms up before it heats: tau_h dP/dt = H - P."""
    network.heater_lag_s = tau_h


def heater_deadtime(network: Network, d_h: float) -> None:
    """Time until a command acts: P(t) = H(t - d_h)."""
    network.signals.heater_dead_s = d_h


def heater_efficiency(network: Network, eta: float) -> None:
    """Share of the rated power that becomes heat of the box: Q = eta H."""
    network.heater_scale *= eta


def radiative_split(network: Network, f_rad: float) -> None:
    """The air gets (1 - f_rad) H; the rest goes to wall and soil, 60 : 40 if there are both, else is lost."""
    network.radiant_share = f_rad


def heater_saturation(network: Network, u_sat: float) -> None:
    """A supply that gives no more: H = H_max min(u, u_sat)."""
    network.signals.duty_limit = u_sat


def heater_sag(network: Network, sag: float) -> None:
    """Voltage that falls, or resistance that rises, with the load: H = H_max u (1 - sag u)."""
    network.signals.duty_sag = sag


def heater_derating(network: Network, k_P: float) -> None:
    """Power that falls as the air warms, as a PTC heater's does: H = H_max u (1 - k_P (T - 20)).

    Its element stays near the temperature T_c at which its resistance rises, so k_P is 1 / (T_c - 20).
    What warm air takes away goes with the command as given, however late or slowly the heat itself comes.
    """
    full_w = network.geometry.heater_max_w

    def flow(now: HeatConditions) -> Floats:
        less = np.clip(k_P * (now.temp - RATED_AT_C), -1.0, 1.0)
        return np.asarray(-full_w * now.column["heater_duty"] * less)

    network.heat(flow, by_temp=True)


def blown_element(network: Network, k_el: float) -> None:
    """A fan that cools the element: its lag is tau_h / (1 + k_el u_f); nothing without `heater_lag`."""
    network.element_by_fan = k_el


POWER_CHECK = "a power meter at the heater's plug"
_STEADY = HiddenBy(BlindRuns.HEATER_STEADY)
_SCALE = (_STEADY, HiddenBy(BlindRuns.HEATER_ONE_LEVEL))
HEATER_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        heater_lag,
        (EffectParameter("tau_h", "s", 1.0, 7200.0, 180.0, ParameterKind.AIR_LAG),),
        source="lumped element, C_h dT_h/dt = H - P with P = h A (T_h - T); TiTeTh of Bacher & Madsen 2011",
        without="negative for minutes after the heater goes on, positive for as long after it goes off",
        starts=({"tau_h": 40.0}, {"tau_h": 180.0}, {"tau_h": 700.0}),
        check="a thermocouple on the heater's element",
        hidden_by=(_STEADY,),
        common=1,
    ),
    Effect(
        heater_deadtime,
        (EffectParameter("d_h", "s", 0.0, 600.0, 30.0, ParameterKind.DEAD_TIME),),
        source="transport delay of a first-order-plus-dead-time process, Åström & Hägglund 1995, ch. 2",
        without="opposite to each change of the duty for one or two rows, then gone at once",
        starts=tuple({"d_h": seconds} for seconds in DEAD_TIMES_S),
        check=POWER_CHECK,
        hidden_by=(_STEADY,),
    ),
    Effect(
        heater_efficiency,
        (EffectParameter("eta", "", 0.0, 2.0, 0.9, nothing_at=1.0),),
        source="tolerance of a rated power input, IEC 60335-1, clause 10",
        without="in proportion to the duty, whatever the temperature",
        starts=({"eta": 0.95},),
        check=POWER_CHECK,
        hidden_by=_SCALE,
    ),
    Effect(
        radiative_split,
        (EffectParameter("f_rad", "", 0.0, 1.0, 0.3),),
        source="convective fraction of a heat emitter, EN 15316-2",
        without="negative in proportion to the duty at first, less so once wall and soil have warmed",
        starts=({"f_rad": 0.1},),
        check="an infrared thermometer on the walls while the heater is on",
    ),
    Effect(
        heater_saturation,
        (EffectParameter("u_sat", "", 0.05, 1.0, 0.8, nothing_at=1.0),),
        source="static input saturation (Hammerstein), Ljung 1999, System Identification, ch. 5",
        without="zero up to some duty, negative in proportion to what the duty is above it",
        starts=({"u_sat": 0.9}, {"u_sat": 0.7}, {"u_sat": 0.5}),
        check=POWER_CHECK,
        hidden_by=_SCALE,
    ),
    Effect(
        heater_sag,
        (EffectParameter("sag", "", 0.0, 0.5, 0.1),),
        source="source resistance and the element's temperature coefficient, to first order in the duty",
        without="negative with the square of the duty",
        starts=({"sag": 0.05},),
        check=POWER_CHECK,
        hidden_by=_SCALE,
    ),
    Effect(
        heater_derating,
        (EffectParameter("k_P", "1/K", 0.0, 0.05, 0.01),),
        source="heat that an element of constant temperature gives to the air, Incropera & DeWitt, ch. 1",
        without="negative in proportion to the duty, and more so in warm air",
        offer=Offer.KNOWN_ONLY,
        check=POWER_CHECK,
        stands_in=True,
        must_change=("heater_duty",),
    ),
    Effect(
        blown_element,
        (EffectParameter("k_el", "", 0.0, 20.0, 1.0),),
        source="film of a cylinder in cross flow, Incropera & DeWitt, ch. 7",
        without="positive for a minute after the fan goes on while the element is hot, then gone",
        offer=Offer.KNOWN_ONLY,
        check="a thermocouple on the heater's element",
    ),
)
