"""The heat balance of the box as a small network: the air, the room, and what effects add to them.

With no effect it is the paper's balance (eq. pbm): rho c V dT/dt = u_h H_max - rho c u_f F_max (T - T_amb).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.geometry import Geometry

Floats = NDArray[np.float64]
AIR, ROOM, HEATER = "air", "room", "heater"
INPUTS = ("heater_duty", "temp_ambient", "source")  # the order of every `drive`: 0..1, °C, K/s into the air


class Path(NamedTuple):
    """Heat between two nodes, in proportion to their difference."""

    one: str
    other: str
    off_w_k: float  # with the fan off [W/K]
    fan_w_k: float  # added with the fan on, in proportion to its speed [W/K]


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """dx/dt = (rates + u_f fan_rates) x + (drive + u_f fan_drive) (u_h, T_amb, r), for the states by name.

    The state `air` is first, what the sensor shows; thermal nodes are in °C, `heater` in W.
    rates, fan_rates : [n, n]; drive, fan_drive : [n, 3], columns as INPUTS
    """

    states: tuple[str, ...]
    rates: Floats
    fan_rates: Floats
    drive: Floats
    fan_drive: Floats
    air_capacity_j_k: float  # of the state `air`


@dataclass(slots=True)
class Network:
    """What effects change: they scale what is there, add nodes, and connect them."""

    geometry: Geometry
    air_capacity_scale: float = 1.0
    fan_flow_scale: float = 1.0
    heater_scale: float = 1.0
    heater_lag_s: float = 0.0  # 0: the heat is there at once
    nodes: dict[str, float] = field(default_factory=dict)  # beside the air: heat capacity [J/K]
    paths: list[Path] = field(default_factory=list)

    def add_node(self, name: str, capacity_j_k: float) -> None:
        """A body of one temperature."""
        self.nodes[name] = capacity_j_k

    def connect(self, one: str, other: str, off_w_k: float, fan_w_k: float = 0.0) -> None:
        """A path between two nodes (`AIR`, `ROOM` or an added one), see `Path`."""
        self.paths.append(Path(one, other, off_w_k, fan_w_k))

    def system(self) -> LinearSystem:
        """The network as a linear system."""
        geometry = self.geometry
        capacities = {AIR: self.air_capacity_scale * geometry.air_capacity_j_k, **self.nodes}
        states = (*capacities, *([HEATER] if self.heater_lag_s > 0.0 else []))
        size, nodes = len(states), len(capacities)
        exhaust_w_k = geometry.volumetric_heat_j_m3_k * geometry.fan_max_m3_s * self.fan_flow_scale
        matrices = np.zeros((2, size, size + 1))  # fan off, added by the fan; the last column is the room
        column = {name: i for i, name in enumerate(capacities)} | {ROOM: size}
        for one, other, off_w_k, fan_w_k in (*self.paths, Path(AIR, ROOM, 0.0, exhaust_w_k)):
            by_fan = np.array([off_w_k, fan_w_k])
            for near, far in ((one, other), (other, one)):
                if near != ROOM:
                    matrices[:, column[near], column[near]] -= by_fan / capacities[near]
                    matrices[:, column[near], column[far]] += by_fan / capacities[near]
        drive = np.zeros((2, size, len(INPUTS)))
        drive[:, :, 1] = matrices[:, :, -1]
        drive[0, 0, 2] = 1.0
        power_w = self.heater_scale * geometry.heater_max_w
        if size == nodes:
            drive[0, 0, 0] = power_w / capacities[AIR]
        else:
            matrices[0, 0, nodes] = 1.0 / capacities[AIR]
            matrices[0, nodes, nodes] = -1.0 / self.heater_lag_s
            drive[0, nodes, 0] = power_w / self.heater_lag_s
        rates, fan_rates = matrices[:, :, :-1]
        return LinearSystem(states, rates, fan_rates, drive[0], drive[1], capacities[AIR])
