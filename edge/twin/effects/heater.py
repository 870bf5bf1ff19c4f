"""Named effects between the heater's command and heat in the box."""

from collections.abc import Mapping

from edge.twin.effects.effect import Effect, EffectParameter
from edge.twin.network import Network


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


HEATER_EFFECTS: Mapping[str, Effect] = {
    "heater_lag": Effect(
        heater_lag,
        (EffectParameter("tau_h", "s", 1.0, 7200.0, 180.0),),
        "lumped element, C_h dT_h/dt = H - P with P = h A (T_h - T); TiTeTh of Bacher & Madsen 2011",
        "negative for minutes after the heater goes on, positive for as long after it goes off",
    ),
    "heater_deadtime": Effect(
        heater_deadtime,
        (EffectParameter("d_h", "s", 0.0, 600.0, 30.0),),
        "transport delay of a first-order-plus-dead-time process, Åström & Hägglund 1995, ch. 2",
        "opposite to each change of the duty for one or two rows, then gone at once",
    ),
    "heater_efficiency": Effect(
        heater_efficiency,
        (EffectParameter("eta", "", 0.0, 2.0, 0.9),),
        "tolerance of a rated power input, IEC 60335-1, clause 10",
        "in proportion to the duty, whatever the temperature",
    ),
    "radiative_split": Effect(
        radiative_split,
        (EffectParameter("f_rad", "", 0.0, 1.0, 0.3),),
        "convective fraction of a heat emitter, EN 15316-2",
        "negative in proportion to the duty at first, less so once wall and soil have warmed",
    ),
    "heater_saturation": Effect(
        heater_saturation,
        (EffectParameter("u_sat", "", 0.05, 1.0, 0.8),),
        "static input saturation (Hammerstein), Ljung 1999, System Identification, ch. 5",
        "zero up to some duty, negative in proportion to what the duty is above it",
    ),
    "heater_sag": Effect(
        heater_sag,
        (EffectParameter("sag", "", 0.0, 0.5, 0.1),),
        "source resistance and the element's temperature coefficient, to first order in the duty",
        "negative with the square of the duty",
    ),
}
