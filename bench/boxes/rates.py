"""Rates of a box, for many states at once.

Walls conduct in finite volumes, surfaces radiate with T^4, films grow with a root of the temperature
difference, two layers of air mix, warm air leaks by buoyancy, and wet soil evaporates. The rates are one
matrix times a column of features: temperatures, fourth powers, film flows, air flows, latent flows, inputs.
"""

import math
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


SMALL = 1e-3  # below, a series is more exact than the quotient
BLOCK = 200  # columns at once: numpy's library would share a larger product among threads, and wait for them


class Modes:
    """Eigenvalues and eigenvectors of slopes A [n, n] of dx/dt = A x + rest."""

    def __init__(self, slopes: Floats) -> None:
        self._slopes = slopes
        self._rates, self._shapes = np.linalg.eig(slopes)
        self._back = np.linalg.inv(self._shapes)

    def matrices(self, dt_s: float) -> Floats:
        """Return [3 n, n] of a step of ETD2RK by its two slopes f(x), f(ahead):

        ahead = x + M[:n] f(x), and x + M[n:2n] f(x) + M[2n:] f(ahead) after the step.
        """
        z = dt_s * self._rates
        near = np.abs(z) < SMALL
        safe = np.where(near, 1.0, z)
        first = np.where(near, 1.0 + z / 2.0 + z * z / 6.0, np.expm1(safe) / safe)
        second = np.where(near, 0.5 + z / 6.0 + z * z / 24.0, (first - 1.0) / safe)
        ahead, late = (dt_s * ((self._shapes * factor) @ self._back).real for factor in (first, second))
        return np.concatenate((ahead, ahead - late - late @ self._slopes @ ahead, late))


def product(matrix: Floats, columns: Floats) -> Floats:
    """Return matrix [n, m] @ columns [m, M], in one thread."""
    count = columns.shape[1]
    if count <= BLOCK:
        return np.asarray(matrix @ columns)
    found = np.empty((len(matrix), count))
    for k in range(0, count, BLOCK):
        found[:, k : k + BLOCK] = matrix @ columns[:, k : k + BLOCK]
    return found


ZERO_C = 273.15
SMOOTH_K2 = 0.0025  # (0.05 K)², so that a film has a slope where the difference is 0
UNSTABLE_M_S = 0.03  # speed at which 1 K mixes air that is warmer below
DROOP_FROM_K = ZERO_C + 60.0
LEAST_PTC_SHARE = 0.1
LATENT_J_G = 1e-3 * LATENT_J_KG
# Saturated vapour, WMO Guide 8 (2018), annex 4.B, as a + b / (T - c), over the gas law [g/m³].
MAGNUS_B_K, MAGNUS_C_K = -17.62 * 243.12, ZERO_C - 243.12
MAGNUS_G_K_M3 = 1e3 * 611.2 / 461.5 * math.exp(17.62)


@dataclass(frozen=True, slots=True)
class HeldInputs:
    """Inputs of some states over a step: the column of features so far, and coefficients by the fan."""

    features: Floats
    coefficients: Floats  # of films, mixing and flow of air, beyond those by temperature
    transfer: Floats  # of vapour at wet surfaces [W m³/g]
    heater_w: Floats


def saturated_g_m3(temp_k: Floats) -> Floats:
    """Return the vapour of saturated air."""
    vapour = temp_k - MAGNUS_C_K
    np.divide(MAGNUS_B_K, vapour, out=vapour)
    np.exp(vapour, out=vapour)
    vapour *= MAGNUS_G_K_M3
    vapour /= temp_k
    return vapour


class BoxRates:
    """Rates of states [n, M]: temperatures [K], vapour [g/m³], sensor [K], heat in and out [J]."""

    def __init__(self, facts: BoxFacts) -> None:
        self.facts = facts
        nodes = self.nodes = nodes_of(facts)
        bodies = len(nodes.capacity)
        self.vapour, self.sensor, self.heat_in, self.heat_out = range(bodies, bodies + 4)
        self.size = bodies + 4
        # Heat capacities [J/K]; that of the vapour is latent [J m³/g].
        self.capacity = np.array([*nodes.capacity, LATENT_J_G * facts.volume_m3, 0.0, 0.0, 0.0])
        nodes.films.sort(key=lambda film: film.power)  # so that each power is one slice
        self._differences(nodes)
        self._coefficients(nodes)
        self._matrix(nodes)

    def hold(self, count: int, around: tuple[float, float, float], heater: Floats, fan: Floats) -> HeldInputs:
        """Set the inputs for `count` states.

        around : room [°C], sun on the window [W/m²], mains (1: nominal); heater, fan : numbers or [M], 0..1
        """
        room_c, sun, mains = around
        features = np.empty((self._spread.shape[1], count))
        features[self.size] = ZERO_C + room_c
        features[self.size + 1] = 1e3 * self.facts.room.vapour_kg_m3
        heater_w = np.asarray(self.facts.heater_w * mains * heater)
        features[self._inputs.start] = heater_w
        features[self._inputs.start + 1] = fan
        features[self._inputs.start + 2] = sun
        return HeldInputs(
            features, self._base + self._blown * fan, self._wet + self._wet_blown * fan, heater_w
        )

    def rates(self, x: Floats, held: HeldInputs) -> Floats:
        """Return dx/dt [n, M] of states [n, M]."""
        z = held.features
        y = z[: self.size + 2]
        y[: self.size] = x
        fourth = y[self._radiating]
        fourth *= fourth
        np.multiply(fourth, fourth, out=z[self._fourth])
        self._flows(z, product(self._between, y), held.coefficients)
        latent = saturated_g_m3(y[self._wets])
        latent -= y[self.vapour]
        dew = latent[self._dew_from :]
        np.minimum(dew, 0.0, out=dew)
        np.multiply(latent, held.transfer, out=z[self._latent])
        if self._element:
            above = np.maximum(y[self._element] - DROOP_FROM_K, 0.0)
            share = np.maximum(1.0 - self.facts.droop_per_k * above, LEAST_PTC_SHARE)
            z[self._inputs.start] = held.heater_w * share
        return product(self._spread, z)

    def felt_k(self, x: Floats) -> Floats:
        """Return the temperature that the sensor of the air shows without bias, noise and steps [M]."""
        if self.facts.air.lag_s:
            return np.asarray(x[self.sensor])
        z = np.zeros((len(self._felt), x.shape[1]))
        z[: self.size] = x
        z[self._fourth][:-1] = x[self._radiating[:-1]] ** 4
        return np.asarray(self._felt @ z)

    def _flows(self, z: Floats, gaps: Floats, coefficients: Floats) -> None:
        """Write the flows by convection: a coefficient that grows with a root of a gap, times a gap."""
        mixing = len(coefficients) - 2
        size = gaps[: mixing + 2] ** 2
        size += SMOOTH_K2
        np.sqrt(size, out=size)
        rise = np.sqrt(size)
        np.sqrt(rise[: self._quarter], out=rise[: self._quarter])
        np.cbrt(size[self._quarter : mixing], out=rise[self._quarter : mixing])
        rise[mixing] *= gaps[mixing] > 0.0  # only air that is warmer below rises by itself
        rise *= self._natural
        rise += coefficients
        np.multiply(rise[:-1], gaps[: mixing + 1], out=z[self._film])
        np.multiply(rise[-1], gaps[mixing + 2 :], out=z[self._flow])

    def _differences(self, nodes: Nodes) -> None:
        """Rows of gaps: films, lower less upper air, air less room, and what moves with a flow of air."""
        n, low, high = self.size, nodes.index["low"], nodes.index["high"]
        mixing = len(nodes.films)
        between = self._between = np.zeros((mixing + 6, n + 2))  # column n is the room, n + 1 its vapour
        for row, film in enumerate(nodes.films):
            between[row, film.warm] = 1.0
            between[row, n if film.cold == ROOM else film.cold] = -1.0
        between[mixing, [low, high]] = 1.0, -1.0
        between[mixing + 1, [low, high, n]] = 0.5, 0.5, -1.0
        # Air enters below, rises, and leaves above.
        between[mixing + 2, [n, low]] = 1.0, -1.0
        between[mixing + 3, [low, high]] = 1.0, -1.0
        between[mixing + 4, [high, n]] = 1.0, -1.0
        between[mixing + 5, [self.vapour, n + 1]] = 1.0, -1.0

    def _coefficients(self, nodes: Nodes) -> None:
        """Coefficients of films [W/K], mixing [W/K] and flow of air [m³/s]: natural, steady, by the fan."""
        facts, films = self.facts, nodes.films
        self._quarter = sum(film.power == films[0].power for film in films)
        gap_m3_s = DISCHARGE * facts.leak_m2 * math.sqrt(2.0 * G_M_S2 * facts.height_m / 293.0)
        mixed_w_k = AIR_J_M3_K * facts.floor_m2
        stirred, crossing = {
            "exchange": (0.5, facts.fan_exchange_share), "stir": (1.0, 0.0), "none": (0.0, 0.0)
        }[facts.fan]  # fmt: skip
        stirred_w_k = AIR_J_M3_K * stirred * facts.fan_m3_s
        fan_m3_s = crossing * facts.fan_m3_s + facts.fan_leak_m3_s
        columns = np.array(
            [
                *((film.natural, film.steady, film.blown) for film in films),
                (UNSTABLE_M_S * mixed_w_k, facts.mixing_m_s * mixed_w_k, stirred_w_k),
                (gap_m3_s, 0.0, fan_m3_s),
            ]
        )
        self._natural, self._base, self._blown = columns.T[:, :, None]
        self._wets = np.array([wet.node for wet in nodes.wets])
        self._dew_from = sum(wet.both_ways for wet in nodes.wets)
        area = LATENT_J_G * np.array([wet.area_m2 for wet in nodes.wets])[:, None]
        # The fan's film carries vapour by Lewis' relation.
        self._wet, self._wet_blown = area * MASS_TRANSFER_M_S, area * facts.fan_film_w_m2_k / AIR_J_M3_K
        self._element = nodes.index.get("element", 0) if facts.droop_per_k else 0

    def _matrix(self, nodes: Nodes) -> None:
        """Spread of the features over the nodes; heat that one node loses, another gains."""
        n = self.size
        pairs = {node for pair in nodes.radiations for node in pair[:2]}
        self._radiating = np.array([*sorted(pairs - {ROOM}), n])
        counts = [n + 2, len(self._radiating), len(nodes.films) + 1, 4, len(nodes.wets), 3]
        ends = np.cumsum(counts)
        _, self._fourth, self._film, self._flow, self._latent, self._inputs = (
            slice(end - count, end) for count, end in zip(counts, ends, strict=True)
        )
        spread = np.zeros((n, ends[-1]))

        def move(column: int, source: int, target: int, amount: float = 1.0) -> None:
            spread[self.heat_out if source == ROOM else source, column] -= amount
            spread[self.heat_out if target == ROOM else target, column] += amount

        for source, target, conductance in nodes.conductances:
            move(source, source, target, conductance)
            move(target, target, source, conductance)
        fourth = {int(node): self._fourth.start + k for k, node in enumerate(self._radiating)}
        fourth[ROOM] = fourth[n]
        for source, target, exchange in nodes.radiations:
            move(fourth[source], source, target, exchange)
            move(fourth[target], target, source, exchange)
        low, high = nodes.index["low"], nodes.index["high"]
        for k, film in enumerate(nodes.films):
            move(self._film.start + k, film.warm, film.cold)
        move(self._film.stop - 1, low, high)
        for k, target in enumerate((low, high, self.heat_out)):  # together 0 for any flow
            spread[target, self._flow.start + k] = AIR_J_M3_K
        move(self._flow.stop - 1, self.vapour, ROOM, LATENT_J_G)
        for k, wet in enumerate(nodes.wets):
            move(self._latent.start + k, wet.node, self.vapour)
        fan = {low: 0.5 * self.facts.fan_w, high: 0.5 * self.facts.fan_w}
        for k, shares in enumerate((nodes.power, fan, nodes.sun_m2)):
            for node, share in shares.items():
                spread[node, self._inputs.start + k] += share
                spread[self.heat_in, self._inputs.start + k] += share
        self._spread = spread / np.where(self.capacity > 0.0, self.capacity, 1.0)[:, None]
        self._sensor_row(nodes, fourth)

    def _sensor_row(self, nodes: Nodes, fourth: dict[int, int]) -> None:
        """Weights of the features in the temperature that the sensor of the air feels, and in its rate."""
        air, low, high, wall = self.facts.air, *(nodes.index[key] for key in ("low", "high", "wall_0"))
        self._felt = np.zeros(self._spread.shape[1])
        self._felt[low] = (1.0 - air.wall_share) * (1.0 - air.high_share)
        self._felt[high] = (1.0 - air.wall_share) * air.high_share
        self._felt[wall] = air.wall_share
        if "element" in nodes.index:
            view = air.element_view * SIGMA_W_M2_K4 / SENSOR_FILM_W_M2_K
            self._felt[fourth[nodes.index["element"]]] = view
            self._felt[fourth[wall]] = -view
        if air.lag_s:
            self._spread[self.sensor] = self._felt / air.lag_s
            self._spread[self.sensor, self.sensor] = -1.0 / air.lag_s
