"""The thermal network: seven nodes, one implicit step.

Nodes: h heater element, p leaf and stem, s soil, o outer sheet, w inner sheet, u air of the heater's zone
(upper), b air of the zone below, with sensor and intake. h, o and, when dry, p, s and w may be without mass.

    h -film- u,  h -radiation-> w, s, p (and u),  u -exchange- b,  u, b -film- w,  b -film- p, s,
    p, s -radiation- w -gap- o -film, radiation- room,  s -floor- room,  room -fan-> b -fan-> u -fan-> room

One step is SDIRK2 (Alexander 1977: two stages, L-stable, stiffly accurate) on the equations with the
coefficients of the step's beginning, so a step of 1 s is right for air that answers in 6 s, and a node
without mass keeps its balance. h, p, s and o touch only w, u and b, so they are eliminated by hand; what
remains is 3 x 3. Each flow is taken at the same mean temperatures at both of its ends: energy is conserved
to rounding.

`NetworkEquations` takes floats and, by the four methods that `training.control.chamber_rows` replaces, arrays
of many boxes; so the board needs no NumPy.
"""

import math
from dataclasses import dataclass
from typing import Any

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, Number
from firmware_protocol.virtual_board.effects import Effects

STEFAN_BOLTZMANN = 5.670374e-8  # [W/(m² K⁴)]
KELVIN = 273.15
WELL_MIXED_W_K = 1.0e6  # exchange that makes two zones one
HEATER_REFERENCE_K = 200.0  # element above air at full power, where constant films are evaluated
SMALLEST_DIFFERENCE_K = 0.5  # natural convection never stops wholly: a room's air moves
LEAF_AND_SOIL_EMISSIVITY = 0.95
# Least mass of a wet node: the heat of water is taken at a step's beginning, so not implicit.
TRACE_J_K = 100.0
LIGHT_J_K = 5.0  # an element with less jumps within a step
MASSLESS_PASSES = 6  # of Newton, for such an element

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
_SECOND_STAGE = (1.0 - GAMMA) / GAMMA

Temperatures = Any  # h p s o w u b [degC], a tuple or [7, B]; replaced, never changed in place


@dataclass(slots=True)
class Loads:
    """Loads on the network during one step, constant within it."""

    room_c: float = 20.0
    draught: float = 1.0  # factor on the outer film
    ageing: float = 1.0  # factor on the loss to the room
    fan_speed: Number = 0.0  # 0..1
    ventilation_w_k: Number = 0.0  # heat capacity rate of the fan's flow
    leak_w_k: Number = 0.0  # of leaks and the door, half from each zone
    heater_w: Number = 0.0
    upper_w: Number = 0.0
    lower_w: Number = 0.0
    plant_w: Number = 0.0
    soil_w: Number = 0.0
    cover_w: Number = 0.0


class NetworkEquations:
    """One step of the nodes' temperatures."""

    def __init__(self, parameters: ChamberParameters, effects: Effects) -> None:
        self._p, self._e = parameters, effects
        box, heater = parameters.box, parameters.heater
        self.capacities = _capacities(parameters, effects)
        walls_m2 = box.cover_m2 - box.floor_m2
        self._upper_m2 = box.floor_m2 + walls_m2 * box.heater_zone_share
        self._lower_m2 = walls_m2 * (1.0 - box.heater_zone_share)
        self._emitting = heater.surface_m2 * heater.emissivity * STEFAN_BOLTZMANN
        views = heater.view_cover + heater.view_soil + heater.view_plant
        self._views = [view / views for view in (heater.view_cover, heater.view_soil, heater.view_plant)]
        self._to_cover, self._to_soil, self._to_plant = (
            effects.radiative_split * view for view in self._views
        )
        self._to_upper = 1.0 - effects.radiative_split

    def after(self, temps: Temperatures, dt_s: float, loads: Loads) -> tuple[Temperatures, Temperatures]:
        """Temperatures after dt_s, short against all nodes with mass but the air, and their mean over it."""
        self._link_surfaces(temps, loads)
        self._link_heater(temps, loads)
        self._eliminate(GAMMA * dt_s, loads)
        first = self._stage(temps, loads)
        end = self._stage(self._between(temps, first, _SECOND_STAGE), loads)
        return end, self._between(first, end, GAMMA)

    def _link_surfaces(self, temps: Temperatures, loads: Loads) -> None:
        """Conductances between air, sheets, soil, leaf and room at the present temperatures."""
        _, p, s, o, w, u, b = temps
        cover, soil, plant, air, effects = self._p.cover, self._p.soil, self._p.plant, self._p.air, self._e
        room, speed, cover_m2 = loads.room_c, loads.fan_speed, self._p.box.cover_m2
        forced = cover.inner_film_fan_w_m2_k * speed
        power = 0.25 * effects.natural_convection
        reference = cover.film_reference_k
        self._wu = self._upper_m2 * (cover.inner_film_w_m2_k * self._growth(u - w, reference, power) + forced)
        self._wb = self._lower_m2 * (cover.inner_film_w_m2_k * self._growth(b - w, reference, power) + forced)
        self._wo = cover_m2 * cover.gap_w_m2_k * loads.ageing
        outer_film = cover.outer_film_w_m2_k * self._growth(o - room, reference, power)
        self._oa = (
            cover_m2 * outer_film * loads.draught * loads.ageing * effects.wall_loss
            + effects.longwave_radiation * longwave_conductance(cover_m2 * cover.emissivity, o, room)
        )
        interior = effects.interior_longwave * LEAF_AND_SOIL_EMISSIVITY
        # A leaf has two sides to the air, and one to the sheet that it sees.
        self._pb = 2.0 * plant.leaf_m2 * plant.film_w_m2_k
        self._pw = interior * longwave_conductance(plant.leaf_m2, p, w)
        self._sb = soil.air_w_k
        self._sw = interior * longwave_conductance(soil.longwave_m2, s, w)
        self._sa = soil.floor_w_k * loads.ageing * effects.wall_loss
        mixing_flow = air.mixing_flow_m3_s + air.fan_mixing_flow_m3_s * speed
        exchange = mixing_flow * air.density_kg_m3 * air.heat_capacity_j_kg_k
        scale = effects.imperfect_mixing
        self._ub = self._at_most_mixed(exchange / scale) if scale > 0.0 else WELL_MIXED_W_K

    def _link_heater(self, temps: Temperatures, loads: Loads) -> None:
        """Film of the element and the tangent of its radiation, q = _rad_w + _rad_w_k T."""
        h, p, s, _, w, u, _ = temps
        cover, soil, plant = self._views
        sinks = cover * (w + KELVIN) ** 4 + soil * (s + KELVIN) ** 4 + plant * (p + KELVIN) ** 4
        passes = 1 if self.capacities[0] > LIGHT_J_K else MASSLESS_PASSES
        for _ in range(passes):
            self._hu = self._heater_film(h - u, loads.fan_speed)
            kelvin = h + KELVIN
            self._rad_w_k = 4.0 * self._emitting * kelvin**3
            self._rad_w = self._emitting * (kelvin**4 - sinks) - self._rad_w_k * h
            if passes > 1:  # without mass the element jumps: follow it before the tangent is drawn
                h = (loads.heater_w - self._rad_w + self._hu * u) / (self._hu + self._rad_w_k)

    def _heater_film(self, difference_k: Number, fan_speed: Number) -> Number:
        """Convection of the element [W/K]: horizontal cylinder, 1.32 (dT/D)^0.25 (Holman 2010, table 7-2)."""
        heater = self._p.heater
        growth = self._growth(difference_k, HEATER_REFERENCE_K, 0.25 * self._e.natural_convection)
        still = 1.32 * (HEATER_REFERENCE_K / heater.diameter_m) ** 0.25 * growth
        return heater.surface_m2 * still * (1.0 + (heater.fan_convection_factor - 1.0) * fan_speed)

    def _eliminate(self, theta_s: float, loads: Loads) -> None:
        """Diagonals of h, p, s, o and the 3 x 3 system that is left, for a stage of length theta_s."""
        # By hand, as the board has no NumPy to solve 7 x 7 equations in every step.
        h, p, s, o, w, u, b = self._rates = [c / theta_s for c in self.capacities]
        leak = 0.5 * loads.leak_w_k
        self._dh = dh = h + self._rad_w_k + self._hu
        self._dp = dp = p + self._pb + self._pw
        self._ds = ds = s + self._sb + self._sw + self._sa
        self._do = do = o + self._wo + self._oa
        self._via = via = self._hu * self._rad_w_k / dh  # radiation per kelvin of the air around the heater
        p_w, p_b, p_u = self._pw / dp, self._pb / dp, self._to_plant * via / dp
        s_w, s_b, s_u = self._sw / ds, self._sb / ds, self._to_soil * via / ds
        self._ww = (
            w + self._wu + self._wb + self._wo + self._pw + self._sw
            - self._wo * self._wo / do - self._pw * p_w - self._sw * s_w
        )  # fmt: skip
        self._w_u = self._wu + self._to_cover * via + self._pw * p_u + self._sw * s_u
        self._w_b = self._wb + self._pw * p_b + self._sw * s_b
        flow = self._ub + loads.ventilation_w_k
        uu = u + self._wu + flow + leak + self._hu - self._hu * self._hu / dh - self._to_upper * via
        bb = b + self._wb + flow + leak + self._pb + self._sb - self._pb * p_b - self._sb * s_b
        self._b_w = self._wb + self._pb * p_w + self._sb * s_w
        b_u = self._ub + self._pb * p_u + self._sb * s_u
        self._uu = uu - self._wu * self._w_u / self._ww
        self._u_b = flow + self._wu * self._w_b / self._ww
        self._b_u = b_u + self._b_w * self._w_u / self._ww
        self._bb = bb - self._b_w * self._w_b / self._ww
        self._determinant = self._uu * self._bb - self._u_b * self._b_u

    def _stage(self, base: Temperatures, loads: Loads) -> Temperatures:
        """Temperatures at a stage's end from those it starts at."""
        ch, cp, cs, co, cw, cu, cb = self._rates
        h, p, s, o, w, u, b = base
        room, leak = loads.room_c, 0.5 * loads.leak_w_k
        h_in = ch * h + loads.heater_w - self._rad_w
        # The part of the radiation that the air's warmth adds comes at the end, through _via.
        radiated = self._rad_w + self._rad_w_k * h_in / self._dh
        p_in = cp * p + loads.plant_w + self._to_plant * radiated
        s_in = cs * s + loads.soil_w + self._to_soil * radiated + self._sa * room
        o_in = co * o + self._oa * room
        w_in = (
            cw * w + loads.cover_w + self._to_cover * radiated
            + self._wo * o_in / self._do + self._pw * p_in / self._dp + self._sw * s_in / self._ds
        )  # fmt: skip
        u_in = cu * u + loads.upper_w + self._hu * h_in / self._dh + self._to_upper * radiated + leak * room
        b_in = (
            cb * b + loads.lower_w + (loads.ventilation_w_k + leak) * room
            + self._pb * p_in / self._dp + self._sb * s_in / self._ds
        )  # fmt: skip
        u_in += self._wu * w_in / self._ww
        b_in += self._b_w * w_in / self._ww
        u = (u_in * self._bb + self._u_b * b_in) / self._determinant
        b = (b_in * self._uu + self._b_u * u_in) / self._determinant
        w = (w_in + self._w_u * u + self._w_b * b) / self._ww
        h = (h_in + self._hu * u) / self._dh
        p = (p_in + self._to_plant * self._via * u + self._pb * b + self._pw * w) / self._dp
        s = (s_in + self._to_soil * self._via * u + self._sb * b + self._sw * w) / self._ds
        return self._nodes(h, p, s, (o_in + self._wo * w) / self._do, w, u, b)

    def _between(self, one: Temperatures, other: Temperatures, share: float) -> Temperatures:
        """Return the temperatures at a share of the way from one to the other."""
        return [a + share * (b - a) for a, b in zip(one, other, strict=True)]

    def _nodes(self, *temps: Number) -> Temperatures:
        return temps

    def _growth(self, difference_k: Number, reference_k: float, power: float) -> Number:
        """Factor on a film of natural convection whose value is given at reference_k."""
        return math.pow(max(abs(difference_k), SMALLEST_DIFFERENCE_K) / reference_k, power)

    def _at_most_mixed(self, exchange_w_k: Number) -> Number:
        return min(exchange_w_k, WELL_MIXED_W_K)


class ThermalNetwork(NetworkEquations):
    """Temperatures of the nodes, and the heat that has left the box by each way."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, temp_c: float) -> None:
        super().__init__(parameters, effects)
        room: Temperatures = (temp_c,) * 7
        self.temps, self.start = room, room
        self.mean = room  # over the last step
        self.radiated_w = 0.0  # by the heater, mean over the last step
        self.cover_j = self.floor_j = self.air_j = 0.0  # heat that has left

    def stored_j(self) -> float:
        """Heat stored since the start [J]."""
        stored: float = sum(
            c * (t - t0) for c, t, t0 in zip(self.capacities, self.temps, self.start, strict=True)
        )
        return stored

    def step(self, dt_s: float, loads: Loads) -> None:
        """Move on by dt_s, which is short against all nodes with mass but the air."""
        self.temps, self.mean = self.after(self.temps, dt_s, loads)
        h, _, s, o, _, u, b = self.mean
        room = loads.room_c
        self.radiated_w = self._rad_w + self._rad_w_k * h
        self.cover_j += dt_s * self._oa * (o - room)
        self.floor_j += dt_s * self._sa * (s - room)
        leak = 0.5 * loads.leak_w_k
        self.air_j += dt_s * ((loads.ventilation_w_k + leak) * (u - room) + leak * (b - room))


def longwave_conductance(area_m2: float, one_c: Number, other_c: Number) -> Number:
    """Heat per kelvin between two surfaces, exact in T^4 [W/K]; area_m2 is area times emissivity."""
    one, other = one_c + KELVIN, other_c + KELVIN
    return area_m2 * STEFAN_BOLTZMANN * (one * one + other * other) * (one + other)


def _capacities(parameters: ChamberParameters, effects: Effects) -> list[float]:
    """Heat capacities of the nodes [J/K]."""
    box, air, cover = parameters.box, parameters.air, parameters.cover
    contact = max(1.0 + effects.extra_capacity * (air.contact_capacity_factor - 1.0), 0.1)
    air_j_k = air.density_kg_m3 * air.heat_capacity_j_kg_k * box.volume_m3 * contact
    sheet_j_k = effects.wall_mass * 0.5 * cover.areal_mass_kg_m2 * cover.heat_capacity_j_kg_k * box.cover_m2
    wet_j_k = TRACE_J_K if effects.evapotranspiration > 0.0 else 0.0
    misted_j_k = TRACE_J_K if effects.condensation > 0.0 else 0.0
    return [
        effects.heater_lag * parameters.heater.capacity_j_k,
        max(effects.plant_mass * parameters.plant.capacity_j_k, wet_j_k),
        max(effects.soil_mass * parameters.soil.capacity_j_k, wet_j_k),
        sheet_j_k,
        max(sheet_j_k, misted_j_k),
        air_j_k * box.heater_zone_share,
        air_j_k * (1.0 - box.heater_zone_share),
    ]
