"""Rates of a box, for many states at once.

Walls conduct in finite volumes, surfaces radiate with T^4, films grow with a root of the temperature
difference, two layers of air mix, warm air leaks by buoyancy, and wet soil evaporates. The rates are one
matrix times a column of features: temperatures, fourth powers, film flows, air flows, latent flows, inputs.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import BoxFacts
from bench.boxes.modes import product
from bench.boxes.nodes import (
    AIR_J_M3_K,
    DISCHARGE,
    G_M_S2,
    LATENT_J_KG,
    MASS_TRANSFER_M_S,
    ROOM,
    SENSOR_FILM_W_M2_K,
    SIGMA_W_M2_K4,
    Nodes,
    nodes_of,
)

Floats = NDArray[np.float64]
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
