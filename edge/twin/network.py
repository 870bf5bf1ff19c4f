"""The heat balance of the box as a small network: the air, the room, and what effects add to them.

With no effect it is the paper's balance (eq. pbm): rho c V dT/dt = u_h H_max - rho c u_f F_max (T - T_amb).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.geometry import Geometry
from edge.twin.signals import Heat, HeatNow, Signals

Floats = NDArray[np.float64]
AIR, ROOM, HEATER, UPPER, SENSOR = "air", "room", "heater", "upper", "sensor"
INPUTS = ("heater_duty", "temp_ambient", "source")  # the order of every `drive`: 0..1, °C, K/s into the air
MODES = ("off", "fan_on", "door_open", "day")  # what matrices are added up by: 1 and three inputs
RADIANT = {"wall": 0.6, "soil": 0.4}  # shares of radiant heat where the twin has both nodes


class Path(NamedTuple):
    """Heat between two nodes, in proportion to their difference [W/K]."""

    one: str
    other: str
    off_w_k: float  # with the fan off
    fan_w_k: float = 0.0  # added with the fan on, in proportion to its speed
    door_w_k: float = 0.0  # added with the door open
    wall: bool = False  # a wall's, which ages


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """dx/dt = (rates + u_f fan_rates) x + (drive + u_f fan_drive) (u_h, T_amb, r), for the states by name.

    The first state is what the sensor shows; thermal nodes are in °C, `heater` in W.
    rates, fan_rates : [n, n]; drive, fan_drive : [n, 3], columns as INPUTS
    other_rates, other_drive : [2, n, n] and [2, n, 3], added times door_open (0..1) and day
    """

    states: tuple[str, ...]
    rates: Floats
    fan_rates: Floats
    drive: Floats
    fan_drive: Floats
    air_capacity_j_k: float  # of all the air
    other_rates: Floats
    other_drive: Floats


@dataclass(slots=True)
class Network:
    """The network that effects change: they scale it, add nodes, connect them, and bend the inputs."""

    geometry: Geometry
    air_capacity_scale: float = 1.0
    fan_flow_scale: float = 1.0
    heater_scale: float = 1.0
    heater_lag_s: float = 0.0  # 0: the heat is there at once
    radiant_share: float = 0.0  # of the heater, that passes the air by
    element_by_fan: float = 0.0  # by which the fan makes the element's heat pass faster: 1 is twice as fast
    mixing_m3_s: float = 0.0  # between two halves of the air; 0: one zone
    sensor_lag_s: float = 0.0  # 0: the sensor shows the air
    signals: Signals = field(default_factory=Signals)
    nodes: dict[str, float] = field(default_factory=dict)  # beside the air: heat capacity [J/K]
    paths: list[Path] = field(default_factory=list)

    def add_node(self, name: str, capacity_j_k: float) -> None:
        """Add a body of one temperature."""
        self.nodes[name] = capacity_j_k

    def connect(
        self,
        one: str,
        other: str,
        off_w_k: float,
        fan_w_k: float = 0.0,
        door_w_k: float = 0.0,
        wall: bool = False,
    ) -> None:
        """Add a path between two nodes (`AIR`, `ROOM` or an added one), see `Path`."""
        self.paths.append(Path(one, other, off_w_k, fan_w_k, door_w_k, wall))

    def heat(self, watts: HeatNow, by_temp: bool = False) -> None:
        """Heat into the air [W]; `by_temp` where it depends on the air's temperature."""
        self.signals.heats.append(Heat(watts, by_temp))

    def system(self) -> LinearSystem:
        """Return the network as a linear system."""
        air_j_k = self.air_capacity_scale * self.geometry.air_capacity_j_k
        zones = (AIR, UPPER) if self.mixing_m3_s > 0.0 else (AIR,)
        capacities = {zone: air_j_k / len(zones) for zone in zones} | self.nodes
        matrices = self._conduction(capacities)
        size = len(capacities)
        drive = np.zeros((len(MODES), size, len(INPUTS)))
        drive[:, :, 1] = matrices[:, :, -1]
        drive[0, : len(zones), 2] = 1.0
        states, rates = tuple(capacities), matrices[:, :, :-1]
        heated = self._heat_rates(capacities)
        if self.heater_lag_s > 0.0:
            states, rates, drive = self._behind_element(states, rates, drive, heated)
        else:
            drive[0, :, 0] = self._power_w() * heated
        if self.sensor_lag_s > 0.0:
            states, rates, drive = self._behind_sensor(states, rates, drive)
        return LinearSystem(states, rates[0], rates[1], drive[0], drive[1], air_j_k, rates[2:], drive[2:])

    def _power_w(self) -> float:
        return self.heater_scale * self.geometry.heater_max_w

    def _conduction(self, capacities: dict[str, float]) -> Floats:
        """Rates by MODES, [4, nodes, nodes + 1]; the last column is the room."""
        heat = self.geometry.volumetric_heat_j_m3_k
        exhaust = Path(AIR, ROOM, 0.0, heat * self.geometry.fan_max_m3_s * self.fan_flow_scale)
        paths = [*self._from_zones(UPPER in capacities), exhaust]
        matrices = np.zeros((len(MODES), len(capacities), len(capacities) + 1))
        column = {name: i for i, name in enumerate(capacities)} | {ROOM: len(capacities)}
        for one, other, off_w_k, fan_w_k, door_w_k, wall in paths:
            by_mode = np.array(
                [off_w_k, fan_w_k, door_w_k, self.signals.ageing_per_day * off_w_k if wall else 0.0]
            )
            for near, far in ((one, other), (other, one)):
                if near != ROOM:
                    matrices[:, column[near], column[near]] -= by_mode / capacities[near]
                    matrices[:, column[near], column[far]] += by_mode / capacities[near]
        return matrices

    def _from_zones(self, two: bool) -> list[Path]:
        """Return the paths, each zone of air having half of those of the air as a whole."""
        if not two:
            return self.paths
        found = [Path(AIR, UPPER, self.geometry.volumetric_heat_j_m3_k * self.mixing_m3_s)]
        for one, other, off_w_k, fan_w_k, door_w_k, wall in self.paths:
            zones = (AIR, UPPER) if one == AIR else (one,)
            share = 1.0 / len(zones)
            found += [
                Path(zone, other, share * off_w_k, share * fan_w_k, share * door_w_k, wall) for zone in zones
            ]
        return found

    def _heat_rates(self, capacities: dict[str, float]) -> Floats:
        """Return the effect of a watt of the heater on each node [K/J]."""
        lit = {name: share for name, share in RADIANT.items() if name in capacities}
        shares = {name: self.radiant_share * share / sum(lit.values()) for name, share in lit.items()}
        shares[UPPER if UPPER in capacities else AIR] = 1.0 - self.radiant_share
        return np.array([shares.get(name, 0.0) / capacity for name, capacity in capacities.items()])

    def _behind_element(
        self, states: tuple[str, ...], rates: Floats, drive: Floats, heated: Floats
    ) -> tuple[tuple[str, ...], Floats, Floats]:
        """Add the element's heat in still air as the last state."""
        rates, drive = _one_more(rates, drive, slice(None, -1))
        for mode, share in ((0, 1.0), (1, self.element_by_fan)):
            rates[mode, :-1, -1] = share * heated
            rates[mode, -1, -1] = -share / self.heater_lag_s
        drive[0, -1, 0] = self._power_w() / self.heater_lag_s
        return (*states, HEATER), rates, drive

    def _behind_sensor(
        self, states: tuple[str, ...], rates: Floats, drive: Floats
    ) -> tuple[tuple[str, ...], Floats, Floats]:
        """Add the sensor's reading as the first state."""
        rates, drive = _one_more(rates, drive, slice(1, None))
        rates[0, 0, 0], rates[0, 0, 1] = -1.0 / self.sensor_lag_s, 1.0 / self.sensor_lag_s
        return (SENSOR, *states), rates, drive


def _one_more(rates: Floats, drive: Floats, old: slice) -> tuple[Floats, Floats]:
    """Room for one more state. old : where those before go"""
    count, size = len(rates), rates.shape[-1] + 1
    wider, driven = np.zeros((count, size, size)), np.zeros((count, size, drive.shape[-1]))
    wider[:, old, old], driven[:, old] = rates, drive
    return wider, driven
