"""Arrays of a box: nodes that store heat, and the ways on which heat passes between them.

Every way takes from one node what it gives to another, so the arrays cannot create heat. ROOM stands for the
outside: its row of the rates is the heat that has left the box.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import MATERIALS, BoxFacts, Layer

Floats = NDArray[np.float64]
SIGMA_W_M2_K4 = 5.670e-8
AIR_J_M3_K = 1.19 * 1006.0  # at 22 °C and 1 atm
LATENT_J_KG = 2.45e6
G_M_S2, DISCHARGE = 9.81, 0.6  # of a sharp-edged gap
# Laminar films on a vertical plate, a heated body and a floor, Holman, Heat Transfer, table 7-2.
PLATE, BODY, FLOOR = 1.42, 1.32, 1.52
PLATE_POWER, FLOOR_POWER = 0.25, 1.0 / 3.0
BODY_M = 0.08  # size of a heating element
POT_M = 0.15
MASS_TRANSFER_M_S = 0.0035  # 4 W/(m² K) of the film by Lewis' relation
SENSOR_FILM_W_M2_K = 12.0
INTERVALS = {"soil": 5, "EPS": 3, "XPS": 3, "plywood": 3, "twin-wall": 2}  # cells of a layer; others 1
ROOM = -1


@dataclass(frozen=True, slots=True)
class Film:
    """Convection between a surface and air: (natural |dT|^power + steady + blown fan) dT."""

    warm: int
    cold: int
    natural: float
    steady: float = 0.0
    blown: float = 0.0
    power: float = PLATE_POWER


@dataclass(frozen=True, slots=True)
class Wet:
    """Surface on which water evaporates or condenses."""

    node: int
    area_m2: float
    both_ways: bool  # False: only dew


@dataclass(slots=True)
class Nodes:
    """Nodes of a box by name, capacities [J/K], and the ways between them."""

    index: dict[str, int] = field(default_factory=dict)
    capacity: list[float] = field(default_factory=list)
    conductances: list[tuple[int, int, float]] = field(default_factory=list)
    radiations: list[tuple[int, int, float]] = field(default_factory=list)
    films: list[Film] = field(default_factory=list)
    wets: list[Wet] = field(default_factory=list)
    power: dict[int, float] = field(default_factory=dict)  # node -> share of the heater's power
    sun_m2: dict[int, float] = field(default_factory=dict)  # node -> absorbing area

    def add(self, name: str, capacity: float) -> int:
        """Add a node and return its index."""
        self.index[name] = len(self.capacity)
        self.capacity.append(capacity)
        return self.index[name]

    def slab(self, name: str, layers: tuple[Layer, ...], area_m2: float) -> list[int]:
        """Add a wall of layers in finite volumes, a node on either face; return its nodes from inside."""
        nodes = [self.add(f"{name}_0", 0.0)]
        for layer in layers:
            solid, count = MATERIALS[layer.material], INTERVALS.get(layer.material, 1)
            thickness_m = layer.thickness_m / count
            half = 0.5 * solid.density_kg_m3 * solid.heat_capacity_j_kg_k * thickness_m * area_m2
            for _ in range(count):
                nodes.append(self.add(f"{name}_{len(nodes)}", half))
                self.capacity[nodes[-2]] += half
                through = solid.conductivity_w_m_k / thickness_m * area_m2
                self.conductances.append((nodes[-2], nodes[-1], through))
        return nodes

    def enclose(self, surfaces: list[tuple[int, float, float]]) -> None:
        """Let surfaces (node, area [m²], emissivity) see each other in proportion to their areas."""
        total = sum(area for _, area, _ in surfaces)
        for k, (node, area, emissivity) in enumerate(surfaces):
            for other, other_area, other_emissivity in surfaces[:k]:
                exchange = 1.0 / (1.0 / emissivity + 1.0 / other_emissivity - 1.0)
                self.radiations.append((node, other, SIGMA_W_M2_K4 * exchange * area * other_area / total))


def nodes_of(facts: BoxFacts) -> Nodes:
    """Build the nodes of a box: air, wall, floor, window, element, contents."""
    nodes = Nodes()
    half_air = 0.5 * AIR_J_M3_K * facts.volume_m3
    low, high = nodes.add("low", half_air), nodes.add("high", half_air)
    surfaces = _shell(nodes, facts, low, high)
    if facts.contents_j_k:
        pots = nodes.add("contents", facts.contents_j_k)
        natural = PLATE / POT_M**PLATE_POWER * facts.contents_m2
        nodes.films.append(Film(pots, low, natural, blown=facts.fan_film_w_m2_k * facts.contents_m2))
        surfaces.append((pots, facts.contents_m2, 0.93))
    _heater(nodes, facts, surfaces)
    nodes.enclose(surfaces)
    _sun(nodes, facts)
    return nodes


def _shell(nodes: Nodes, facts: BoxFacts, low: int, high: int) -> list[tuple[int, float, float]]:
    """Wall, window and floor between the air and the room; return their inner surfaces."""
    blown, dew = facts.fan_film_w_m2_k, nodes.wets
    plate = PLATE / facts.height_m**PLATE_POWER
    area = facts.wall_m2 - facts.window_m2
    wall = nodes.slab("wall", facts.wall, area)
    for air in (low, high):
        nodes.films.append(Film(wall[0], air, 0.5 * plate * area, blown=0.5 * blown * area))
    nodes.films.append(Film(wall[-1], ROOM, plate * area, facts.draught_w_m2_k * area))
    nodes.radiations.append((wall[-1], ROOM, SIGMA_W_M2_K4 * facts.wall_emissivity_out * area))
    dew.append(Wet(wall[0], area, both_ways=False))
    surfaces = [(wall[0], area, facts.wall_emissivity_in)]
    if facts.window_m2:
        pane = nodes.slab("window", (facts.window,), facts.window_m2)
        glass = facts.window_m2
        nodes.films.append(Film(pane[0], high, plate * glass, blown=blown * glass))
        nodes.films.append(Film(pane[-1], ROOM, plate * glass, facts.draught_w_m2_k * glass))
        nodes.radiations.append((pane[-1], ROOM, SIGMA_W_M2_K4 * 0.9 * glass))
        dew.append(Wet(pane[0], glass, both_ways=False))
        surfaces.append((pane[0], glass, 0.9))
    ground, base = nodes.slab("floor", facts.floor, facts.floor_m2), facts.floor_m2
    nodes.films.append(Film(ground[0], low, FLOOR * base, blown=blown * base, power=FLOOR_POWER))
    # Under the box warm air cannot rise: half a plate's film, and no view of the room's walls.
    nodes.films.append(Film(ground[-1], ROOM, 0.5 * plate * base, facts.draught_w_m2_k * base))
    if facts.has_soil:
        nodes.wets.insert(0, Wet(ground[0], facts.wet_share * base, both_ways=True))
    return [*surfaces, (ground[0], base, 0.93)]


def _heater(nodes: Nodes, facts: BoxFacts, surfaces: list[tuple[int, float, float]]) -> None:
    low, high = nodes.index["low"], nodes.index["high"]
    if facts.heater == "wire":
        nodes.power = {low: 1.0 - facts.plume_share, high: facts.plume_share}
        return
    if facts.heater == "mat":
        under = INTERVALS["soil"] if facts.has_soil else 0
        nodes.power = {nodes.index[f"floor_{under}"]: 1.0}
        return
    element = nodes.add("element", facts.element_j_k)
    natural = BODY / BODY_M**PLATE_POWER * facts.element_m2
    for air, share in ((low, 1.0 - facts.plume_share), (high, facts.plume_share)):
        blown = 0.5 * facts.fan_film_w_m2_k * facts.element_m2
        nodes.films.append(
            Film(element, air, share * natural, share * facts.element_blown_w_k, share * blown)
        )
    surfaces.append((element, facts.element_m2, facts.element_emissivity))
    nodes.power = {element: 1.0}


def _sun(nodes: Nodes, facts: BoxFacts) -> None:
    """Sun that enters falls on floor, wall and contents; more of it warms the wall's outer face."""
    inside = facts.sunlit_m2 * facts.sun_share
    shares = {"floor_0": 0.5, "wall_0": 0.3, "contents" if facts.contents_j_k else "low": 0.2}
    nodes.sun_m2 = {nodes.index[name]: share * inside for name, share in shares.items()}
    outer = max(node for name, node in nodes.index.items() if name.startswith("wall_"))
    nodes.sun_m2[outer] = nodes.sun_m2.get(outer, 0.0) + facts.sunlit_m2 * facts.sun_on_wall_share
