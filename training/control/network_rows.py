"""The chamber's thermal network for many boxes at once: `firmware_protocol.virtual_board.network`, by arrays.

The same equations in the same order; test_control_chamber.py holds the one to the other. Supported is
what the default chamber has: an element with mass, and films that grow with the difference or not at all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.network import (
    GAMMA,
    HEATER_REFERENCE_K,
    KELVIN,
    LEAF_AND_SOIL_EMISSIVITY,
    SMALLEST_DIFFERENCE_K,
    STEFAN_BOLTZMANN,
    WELL_MIXED_W_K,
    ThermalNetwork,
    longwave_conductance,
)

Floats = NDArray[np.float64]
SECOND_STAGE = (1.0 - GAMMA) / GAMMA


@dataclass(slots=True)
class LoadRows:
    """As `network.Loads`; what differs from box to box is an array [B] [W, W/K, 0..1]."""

    room_c: float
    draught: float
    ageing: float
    fan_speed: Floats
    ventilation_w_k: Floats
    leak_w_k: Floats
    heater_w: Floats
    upper_w: Floats | float
    lower_w: Floats | float
    plant_w: Floats
    soil_w: Floats
    cover_w: Floats


@dataclass(frozen=True, slots=True)
class NetworkRows:
    """Steps temperatures [7, B]: h p s o w u b [degC], as `network.ThermalNetwork`."""

    p: ChamberParameters
    e: Effects
    capacities: tuple[float, ...]

    @classmethod
    def of(cls, parameters: ChamberParameters, effects: Effects) -> "NetworkRows":
        """The network of a chamber."""
        return cls(parameters, effects, tuple(ThermalNetwork(parameters, effects, 20.0).capacities))

    def step(self, temps: Floats, dt_s: float, loads: LoadRows) -> tuple[Floats, Floats]:
        """Temperatures after dt_s, and their mean over it."""
        surfaces = self._surfaces(temps, loads)
        stage = _Stage(self, temps, GAMMA * dt_s, loads, surfaces)
        first = stage.end(temps)
        after = stage.end(temps + SECOND_STAGE * (first - temps))
        return after, first + GAMMA * (after - first)

    def _surfaces(self, temps: Floats, loads: LoadRows) -> "_Surfaces":
        """Conductances between air, sheets, soil, leaf and room at the present temperatures."""
        _, p, s, o, w, u, b = temps
        cover, soil, plant, air, effects = self.p.cover, self.p.soil, self.p.plant, self.p.air, self.e
        box, speed = self.p.box, loads.fan_speed
        walls_m2 = box.cover_m2 - box.floor_m2
        upper_m2 = box.floor_m2 + walls_m2 * box.heater_zone_share
        lower_m2 = walls_m2 * (1.0 - box.heater_zone_share)
        forced = cover.inner_film_fan_w_m2_k * speed
        interior = effects.interior_longwave * LEAF_AND_SOIL_EMISSIVITY
        mixing_flow = air.mixing_flow_m3_s + air.fan_mixing_flow_m3_s * speed
        exchange = mixing_flow * air.density_kg_m3 * air.heat_capacity_j_kg_k
        outer = cover.outer_film_w_m2_k * self._growth(o - loads.room_c, cover.film_reference_k)
        inner = cover.inner_film_w_m2_k
        return _Surfaces(
            wu=upper_m2 * (inner * self._growth(u - w, cover.film_reference_k) + forced),
            wb=lower_m2 * (inner * self._growth(b - w, cover.film_reference_k) + forced),
            wo=box.cover_m2 * cover.gap_w_m2_k * loads.ageing,
            oa=box.cover_m2 * outer * loads.draught * loads.ageing * effects.wall_loss
            + effects.longwave_radiation
            * longwave_conductance(box.cover_m2 * cover.emissivity, o, loads.room_c),
            pb=2.0 * plant.leaf_m2 * plant.film_w_m2_k,
            pw=interior * longwave_conductance(plant.leaf_m2, p, w),
            sb=soil.air_w_k,
            sw=interior * longwave_conductance(soil.longwave_m2, s, w),
            sa=soil.floor_w_k * loads.ageing * effects.wall_loss,
            ub=np.minimum(exchange / effects.imperfect_mixing, WELL_MIXED_W_K),
        )

    def heater_film(self, difference_k: Floats, fan_speed: Floats) -> Floats:
        """Convection of the element [W/K]."""
        heater = self.p.heater
        still = 1.32 * (HEATER_REFERENCE_K / heater.diameter_m) ** 0.25
        still_w = still * self._growth(difference_k, HEATER_REFERENCE_K)
        return np.asarray(
            heater.surface_m2 * still_w * (1.0 + (heater.fan_convection_factor - 1.0) * fan_speed)
        )

    def _growth(self, difference_k: Floats, reference_k: float) -> Floats:
        ratio = np.maximum(np.abs(difference_k), SMALLEST_DIFFERENCE_K) / reference_k
        power = 0.25 * self.e.natural_convection
        return np.sqrt(np.sqrt(ratio)) if power == 0.25 else np.asarray(ratio**power)


@dataclass(slots=True)
class _Surfaces:
    wu: Floats
    wb: Floats
    wo: float
    oa: Floats
    pb: float
    pw: Floats
    sb: float
    sw: Floats
    sa: float
    ub: Floats


class _Stage:
    """One implicit stage of length theta_s: h, p, s and o eliminated by hand, 3 x 3 left."""

    def __init__(
        self, network: NetworkRows, temps: Floats, theta_s: float, loads: LoadRows, g: _Surfaces
    ) -> None:
        heater, effects = network.p.heater, network.e
        views = np.array([heater.view_cover, heater.view_soil, heater.view_plant])
        views = views / views.sum()
        self._to_cover, self._to_soil, self._to_plant = effects.radiative_split * views
        self._to_upper = 1.0 - effects.radiative_split
        self._g, self._loads = g, loads
        self._rates = [capacity / theta_s for capacity in network.capacities]
        h, p, s, _, w, u, _ = temps
        cover, soil, plant = views
        emitting = heater.surface_m2 * heater.emissivity * STEFAN_BOLTZMANN
        sinks = cover * (w + KELVIN) ** 4 + soil * (s + KELVIN) ** 4 + plant * (p + KELVIN) ** 4
        kelvin = h + KELVIN
        self._hu = network.heater_film(h - u, loads.fan_speed)
        self._rad_w_k = 4.0 * emitting * kelvin**3
        self._rad_w = emitting * (kelvin**4 - sinks) - self._rad_w_k * h
        self._eliminate()

    def _eliminate(self) -> None:
        g, loads = self._g, self._loads
        h, p, s, o, w, u, b = self._rates
        leak = 0.5 * loads.leak_w_k
        self._dh = h + self._rad_w_k + self._hu
        self._dp = p + g.pb + g.pw
        self._ds = s + g.sb + g.sw + g.sa
        self._do = o + g.wo + g.oa
        self._via = self._hu * self._rad_w_k / self._dh
        p_w, p_b, p_u = g.pw / self._dp, g.pb / self._dp, self._to_plant * self._via / self._dp
        s_w, s_b, s_u = g.sw / self._ds, g.sb / self._ds, self._to_soil * self._via / self._ds
        self._ww = w + g.wu + g.wb + g.wo + g.pw + g.sw - g.wo * g.wo / self._do - g.pw * p_w - g.sw * s_w
        self._w_u = g.wu + self._to_cover * self._via + g.pw * p_u + g.sw * s_u
        self._w_b = g.wb + g.pw * p_b + g.sw * s_b
        flow = g.ub + loads.ventilation_w_k
        uu = u + g.wu + flow + leak + self._hu - self._hu**2 / self._dh - self._to_upper * self._via
        bb = b + g.wb + flow + leak + g.pb + g.sb - g.pb * p_b - g.sb * s_b
        self._b_w = g.wb + g.pb * p_w + g.sb * s_w
        b_u = g.ub + g.pb * p_u + g.sb * s_u
        self._uu = uu - g.wu * self._w_u / self._ww
        self._u_b = flow + g.wu * self._w_b / self._ww
        self._b_u = b_u + self._b_w * self._w_u / self._ww
        self._bb = bb - self._b_w * self._w_b / self._ww
        self._determinant = self._uu * self._bb - self._u_b * self._b_u

    def end(self, base: Floats) -> Floats:
        """Temperatures at the stage's end from those it starts at, [7, B]."""
        g, loads = self._g, self._loads
        ch, cp, cs, co, cw, cu, cb = self._rates
        h, p, s, o, w, u, b = base
        room, leak = loads.room_c, 0.5 * loads.leak_w_k
        h_in = ch * h + loads.heater_w - self._rad_w
        radiated = self._rad_w + self._rad_w_k * h_in / self._dh
        p_in = cp * p + loads.plant_w + self._to_plant * radiated
        s_in = cs * s + loads.soil_w + self._to_soil * radiated + g.sa * room
        o_in = co * o + g.oa * room
        w_in = (
            cw * w + loads.cover_w + self._to_cover * radiated
            + g.wo * o_in / self._do + g.pw * p_in / self._dp + g.sw * s_in / self._ds
        )  # fmt: skip
        u_in = cu * u + loads.upper_w + self._hu * h_in / self._dh + self._to_upper * radiated + leak * room
        b_in = (
            cb * b + loads.lower_w + (loads.ventilation_w_k + leak) * room
            + g.pb * p_in / self._dp + g.sb * s_in / self._ds
        )  # fmt: skip
        u_in = u_in + g.wu * w_in / self._ww
        b_in = b_in + self._b_w * w_in / self._ww
        u = (u_in * self._bb + self._u_b * b_in) / self._determinant
        b = (b_in * self._uu + self._b_u * u_in) / self._determinant
        w = (w_in + self._w_u * u + self._w_b * b) / self._ww
        h = (h_in + self._hu * u) / self._dh
        p = (p_in + self._to_plant * self._via * u + g.pb * b + g.pw * w) / self._dp
        s = (s_in + self._to_soil * self._via * u + g.sb * b + g.sw * w) / self._ds
        return np.stack([h, p, s, (o_in + g.wo * w) / self._do, w, u, b])
