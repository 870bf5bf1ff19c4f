"""The library of named effects: what the base balance leaves out. One function and one table row each.

A function is given the network and its parameters and adds the effect. `Effect.without` says what the
residual, measured minus predicted, looks like where the effect is missing.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from edge.config_schema import nearest
from edge.errors import DataError
from edge.twin.geometry import Geometry
from edge.twin.network import AIR, ROOM, Network

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect: where it can lie, and where a fit begins."""

    name: str
    unit: str
    low: float
    high: float
    start: float

    def problem(self, value: float) -> str:
        """Why `value` can't be, "" where it can."""
        if not math.isfinite(value):
            return f"{value} is not a finite number"
        if not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            return f"{value:g} is outside {self.low:g}..{self.high:g}{unit}"
        return ""


@dataclass(frozen=True, slots=True)
class Effect:
    """A row of the table."""

    add: Callable[..., None]
    parameters: tuple[Parameter, ...]
    source: str
    without: str
    replaces: str = ""  # an effect that is not applied beside this one

    def parameter(self, name: str) -> Parameter:
        """By name. Errors: KeyError."""
        return {item.name: item for item in self.parameters}[name]


def wall_loss(network: Network, UA: float) -> None:
    """Heat straight through the walls: Q = -UA (T - T_amb)."""
    network.connect(AIR, ROOM, UA)


def wall_mass(network: Network, C_w: float, G_in: float, G_out: float) -> None:
    """Walls that store heat: C_w dT_w/dt = G_in (T - T_w) - G_out (T_w - T_amb).

    It replaces `wall_loss`: at rest 1/UA = 1/G_in + 1/G_out.
    """
    network.add_node("wall", C_w)
    network.connect(AIR, "wall", G_in)
    network.connect("wall", ROOM, G_out)


def extra_capacity(network: Network, kC: float) -> None:
    """Things in close contact with the air: its capacity times kC."""
    network.air_capacity_scale *= kC


def heater_lag(network: Network, tau_h: float) -> None:
    """The element warms up before it heats: tau_h dP/dt = H - P."""
    network.heater_lag_s = tau_h


def heater_efficiency(network: Network, eta: float) -> None:
    """Share of the rated power that becomes heat of the box: Q = eta H."""
    network.heater_scale *= eta


def fan_effectiveness(network: Network, eps_f: float) -> None:
    """Share of the rated flow that changes air, against filters and the box's resistance: F -> eps_f F."""
    network.fan_flow_scale *= eps_f


EFFECTS: Mapping[str, Effect] = {
    "wall_loss": Effect(
        wall_loss,
        (Parameter("UA", "W/K", 0.0, 100.0, 4.0),),
        "thermal transmittance, ISO 6946",
        "falls with T - T_amb: a warm box is predicted too warm, and ever more with the fan off",
    ),
    "wall_mass": Effect(
        wall_mass,
        (
            Parameter("C_w", "J/K", 100.0, 1e6, 5000.0),
            Parameter("G_in", "W/K", 0.01, 500.0, 10.0),
            Parameter("G_out", "W/K", 0.01, 500.0, 8.0),
        ),
        "two-state lumped wall (TiTe), Bacher & Madsen 2011, Energy and Buildings 43",
        "negative when the box has just been warmed, positive for the hour after it cools",
        replaces="wall_loss",
    ),
    "extra_capacity": Effect(
        extra_capacity,
        (Parameter("kC", "", 1.0, 1000.0, 5.0),),
        "internal heat capacity of a zone, air and furniture, ISO 52016-1",
        "the predicted temperature jumps where the measured one rises: opposite signs just after each switch",
    ),
    "heater_lag": Effect(
        heater_lag,
        (Parameter("tau_h", "s", 1.0, 7200.0, 180.0),),
        "lumped element, C_h dT_h/dt = H - P with P = h A (T_h - T); TiTeTh of Bacher & Madsen 2011",
        "negative for minutes after the heater goes on, positive for as long after it goes off",
    ),
    "heater_efficiency": Effect(
        heater_efficiency,
        (Parameter("eta", "", 0.0, 2.0, 0.9),),
        "tolerance of a rated power input, IEC 60335-1, clause 10",
        "in proportion to the duty, whatever the temperature",
    ),
    "fan_effectiveness": Effect(
        fan_effectiveness,
        (Parameter("eps_f", "", 0.0, 2.0, 0.8),),
        "system effect on a fan's rating, AMCA Publication 201",
        "positive with the fan on, in proportion to T - T_amb",
    ),
}


def build(geometry: Geometry, effects: Effects) -> Network:
    """The base balance with effects added. Errors: DataError, `effects.wall_loss.UA: ...`."""
    for name, values in effects.items():
        check_names(name, values)
        for parameter in EFFECTS[name].parameters:
            if problem := parameter.problem(values[parameter.name]):
                raise DataError(f"effects.{name}.{parameter.name}: {problem}")
    network = Network(geometry)
    for name in applied(effects):
        EFFECTS[name].add(network, **effects[name])
    return network


def check_names(name: str, parameters: Iterable[str]) -> None:
    """Refuse an unknown effect, and parameters that are not exactly its own. Errors: DataError."""
    if name not in EFFECTS:
        raise DataError(f"effects: unknown effect {name!r}; {nearest(str(name), EFFECTS)}")
    own = [item.name for item in EFFECTS[name].parameters]
    given = list(parameters)
    for key in given:
        if key not in own:
            raise DataError(f"effects.{name}: unknown parameter {key!r}; {nearest(str(key), own)}")
    for key in own:
        if key not in given:
            raise DataError(f"effects.{name}.{key}: missing")


def applied(effects: Iterable[str]) -> list[str]:
    """The effects that act: not those that another one here replaces."""
    names = list(effects)
    replaced = {EFFECTS[name].replaces for name in names}
    return [name for name in names if name not in replaced]
