"""Named effects: heater; fan and air; losses and stores; sensors and heat from elsewhere; rarer ones."""

from collections.abc import Mapping
from itertools import product

import numpy as np

from edge.twin.effects.effect import (
    DEAD_TIMES_S,
    BlindRuns,
    Effect,
    EffectParameter,
    HiddenBy,
    Offer,
    ParameterKind,
    UnitFactor,
    Values,
    by_name,
)
from edge.twin.network import AIR, ROOM, Network
from edge.twin.signals import Floats, HeatConditions

# the heater


RATED_AT_C = 20.0  # a rated power is that in a room


def heater_lag(network: Network, tau_h: float) -> None:
    """The element warms up before it heats: tau_h dP/dt = H - P."""
    network.heater_lag_s = tau_h


def heater_deadtime(network: Network, d_h: float) -> None:
    """A heater that acts late: P(t) = H(t - d_h)."""
    network.signals.heater_dead_s = d_h


def heater_efficiency(network: Network, eta: float) -> None:
    """A heater that gives less than its rated power: Q = eta H."""
    network.heater_scale *= eta


def radiative_split(network: Network, f_rad: float) -> None:
    """Heat that the heater radiates past the air: Q = (1 - f_rad) H to the air.

    The rest goes to wall and soil, 60 : 40 if there are both, else is lost.
    """
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
        must_change=("heater_duty",),
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
        must_change=("heater_duty",),
        without="opposite to each change of the duty for one or two rows, then gone at once",
        starts=tuple({"d_h": seconds} for seconds in DEAD_TIMES_S),
        check=POWER_CHECK,
        hidden_by=(_STEADY,),
    ),
    Effect(
        heater_efficiency,
        (EffectParameter("eta", "", 0.0, 2.0, 0.9, nothing_at=1.0),),
        source="tolerance of a rated power input, IEC 60335-1, clause 10",
        must_change=("heater_duty",),
        without="in proportion to the duty, whatever the temperature",
        starts=({"eta": 0.95},),
        check=POWER_CHECK,
        hidden_by=_SCALE,
    ),
    Effect(
        radiative_split,
        (EffectParameter("f_rad", "", 0.0, 1.0, 0.3),),
        source="convective fraction of a heat emitter, EN 15316-2",
        must_change=("heater_duty",),
        without="negative in proportion to the duty at first, less so once wall and soil have warmed",
        starts=({"f_rad": 0.1}, {"f_rad": 0.9}),
        check="an infrared thermometer on the walls while the heater is on",
    ),
    Effect(
        heater_saturation,
        (EffectParameter("u_sat", "", 0.05, 1.0, 0.8, nothing_at=1.0),),
        source="static input saturation (Hammerstein), Ljung 1999, System Identification, ch. 5",
        must_change=("heater_duty",),
        without="zero up to some duty, negative in proportion to what the duty is above it",
        starts=({"u_sat": 0.9}, {"u_sat": 0.7}, {"u_sat": 0.5}),
        check=POWER_CHECK,
        hidden_by=_SCALE,
    ),
    Effect(
        heater_sag,
        (EffectParameter("sag", "", 0.0, 0.5, 0.1),),
        source="source resistance and the element's temperature coefficient, to first order in the duty",
        must_change=("heater_duty",),
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


# the fan, and how air moves


_SPEED_STEP = 3e-3  # a fan's speed is rounded (edge/twin/rollout.py): shorter steps of tau_f change nothing


def fan_effectiveness(network: Network, eps_f: float) -> None:
    """A fan that moves less than its rated flow, against filters and the box: F -> eps_f F."""
    network.fan_flow_scale *= eps_f


def short_circuit(network: Network, s_sc: float) -> None:
    """Supply air that leaves before it mixes: F -> (1 - s_sc) F."""
    network.fan_flow_scale *= 1.0 - s_sc


def fan_deadtime(network: Network, d_f: float) -> None:
    """A fan that acts late: F(t) = F_cmd(t - d_f)."""
    network.signals.fan_dead_s = d_f


def fan_spinup(network: Network, tau_f: float) -> None:
    """A rotor that takes time: tau_f ds/dt = u_f - s, F = s F_max."""
    network.signals.fan_lag_s = tau_f


def imperfect_mixing(network: Network, F_mix: float) -> None:
    """Air that mixes slowly between heater and sensor: two halves exchange F_mix.

    The heater is in one half, sensor and intake in the other. Walls, soil, leaks and other heat have half
    their share in each.
    """
    network.mixing_m3_s = F_mix


def stirred_loss(network: Network, G_stir: float) -> None:
    """Films that thin in moving air: Q = -u_f G_stir (T - T_amb)."""
    network.connect(AIR, ROOM, 0.0, G_stir)


FLOW_CHECK = "a calibration of the fan's flow by an anemometer"
_VANE = "a tachometer or a vane behind the fan"
_FAN_STEADY = (HiddenBy(BlindRuns.FAN_STEADY),)
AIR_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        fan_effectiveness,
        (EffectParameter("eps_f", "", 0.0, 2.0, 0.8, nothing_at=1.0),),
        source="system effect on a fan's rating, AMCA Publication 201",
        must_change=("fan_on",),
        without="positive with the fan on, in proportion to T - T_amb",
        by_flow=True,
        starts=({"eps_f": 0.95},),
        check=FLOW_CHECK,
    ),
    Effect(
        short_circuit,
        (EffectParameter("s_sc", "", 0.0, 1.0, 0.2),),
        source="air change effectiveness, ASHRAE Standard 129",
        must_change=("fan_on",),
        without="positive with the fan on, in proportion to T - T_amb",
        by_flow=True,
        starts=({"s_sc": 0.05},),
        check="smoke or a tracer gas that shows where the supply air goes",
    ),
    Effect(
        fan_deadtime,
        (EffectParameter("d_f", "s", 0.0, 600.0, 20.0, ParameterKind.DEAD_TIME),),
        source="transport delay of a first-order-plus-dead-time process, Åström & Hägglund 1995, ch. 2",
        must_change=("fan_on",),
        without="positive for one or two rows after the fan goes on in a warm box, "
        "negative after it goes off",
        by_flow=True,
        starts=tuple({"d_f": seconds} for seconds in DEAD_TIMES_S),
        check=_VANE,
        hidden_by=_FAN_STEADY,
    ),
    Effect(
        fan_spinup,
        (EffectParameter("tau_f", "s", 0.5, 600.0, 20.0, ParameterKind.LAG, difference=_SPEED_STEP),),
        source="rotor inertia to first order, ASHRAE HVAC Systems and Equipment 2016, ch. 21",
        must_change=("fan_on",),
        without="positive after the fan goes on in a warm box and negative after it goes off, fading",
        by_flow=True,
        starts=({"tau_f": 10.0}, {"tau_f": 40.0}),
        check=_VANE,
        hidden_by=_FAN_STEADY,
    ),
    Effect(
        imperfect_mixing,
        (EffectParameter("F_mix", "m³/s", 1e-4, 1.0, 0.02),),
        source="two-zone model of a room, Sandberg 1981, Building and Environment 16",
        without="the sensor rises late after the heater goes on, "
        "and the fan takes out less heat than it should",
        starts=({"F_mix": 0.004}, {"F_mix": 0.02}, {"F_mix": 0.1}),
        check="a second thermometer in the heater's half of the box",
        common=4,
    ),
    Effect(
        stirred_loss,
        (EffectParameter("G_stir", "W/K", 0.0, 100.0, 2.0),),
        source="forced convection at a wall, Incropera & DeWitt, ch. 7",
        without="negative with the fan on, in proportion to T - T_amb",
        offer=Offer.KNOWN_ONLY,
    ),
)


# losses and stores


STEFAN_BOLTZMANN = 5.670374419e-8  # W/(m² K⁴), CODATA 2018
KELVIN = 273.15
_TANGENT_K = 298.15  # where radiation is linearised; what is left over is heat by the temperature


# Effect and parameter of each conductance that other walls change.
WALL_CONDUCTANCES = (("wall_mass", "G_in"), ("wall_mass", "G_out"), ("wall_loss", "UA"))
# And of each capacity that they may be part of, with its value without any.
WALL_CAPACITIES = (("wall_mass", "C_w", 0.0), ("extra_capacity", "kC", 1.0))


def wall_loss(network: Network, UA: float) -> None:
    """Heat straight through the walls: Q = -UA (T - T_amb)."""
    network.connect(AIR, ROOM, UA, wall=True)


def infiltration(network: Network, F_inf: float) -> None:
    """Air leaks while the fan is off: Q = -(1 - u_f) rho c_p F_inf (T - T_amb)."""
    leak_w_k = network.geometry.volumetric_heat_j_m3_k * F_inf
    network.connect(AIR, ROOM, leak_w_k, -leak_w_k)


def wall_mass(network: Network, C_w: float, G_in: float, G_out: float) -> None:
    """Walls that store heat: C_w dT_w/dt = G_in (T - T_w) - G_out (T_w - T_amb).

    It replaces `wall_loss`: at rest 1/UA = 1/G_in + 1/G_out.
    """
    network.add_node("wall", C_w)
    network.connect(AIR, "wall", G_in)
    network.connect("wall", ROOM, G_out, wall=True)


def soil_mass(network: Network, C_s: float, G_s: float) -> None:
    """Contents, such as soil and pots, store heat: C_s dT_s/dt = G_s (T - T_s)."""
    network.add_node("soil", C_s)
    network.connect(AIR, "soil", G_s)


def extra_capacity(network: Network, kC: float) -> None:
    """Things in close contact with the air: its capacity times kC."""
    network.air_capacity_scale *= kC


def longwave_radiation(network: Network, epsA: float) -> None:
    """Radiation to the room: Q = -epsA sigma (T^4 - T_amb^4), temperatures in kelvin."""
    tangent_w_k = 4.0 * epsA * STEFAN_BOLTZMANN * _TANGENT_K**3
    network.connect(AIR, ROOM, tangent_w_k)

    def beyond_tangent(now: HeatConditions) -> Floats:
        box, room = (now.temp + KELVIN) ** 2, (now.ambient + KELVIN) ** 2
        fourth = (box - room) * (box + room)  # T^4 - T_amb^4, several times faster than powers
        return tangent_w_k * (now.temp - now.ambient) - epsA * STEFAN_BOLTZMANN * fourth

    network.heat(beyond_tangent, by_temp=True)


def door_opening(network: Network, G_door: float) -> None:
    """Air exchanged through an open door: Q = -G_door (T - T_amb) in short events.

    The column `door_open`, the share of a step, tells the events where they are known; else it is closed.
    """
    network.connect(AIR, ROOM, 0.0, 0.0, G_door)
    network.signals.door = True


def ua_drift(network: Network, ua_drift: float) -> None:
    """Walls that change, by seals or growth: UA = UA0 (1 + ua_drift day), days since `day0_utc`.

    UA0 is that of `wall_loss`, or G_out of `wall_mass`; it ends at 0.
    """
    network.signals.ageing_per_day = ua_drift


_WALL_CAPACITIES_J_K = (2000.0, 20000.0)
_INNER_TIMES_OUTER = (0.4, 2.5)  # of the two films of a wall whose loss as a whole is known
_USUAL_UA_W_K = 4.0  # where it is not


def _films_in_series(own: Values) -> Values:
    """Loss of a wall that stores heat, at rest: 1/UA = 1/G_in + 1/G_out."""
    return {"UA": 1.0 / (1.0 / own["G_in"] + 1.0 / own["G_out"])}


def _walls(loss: Values, factor: UnitFactor) -> list[Values]:
    """Films that give the known loss in series."""
    known = loss.get("UA", 0.0)
    ua_w_k = known if known > 0.0 else _USUAL_UA_W_K * factor("W/K")
    return [
        {
            "C_w": capacity * factor("J/K"),
            "G_in": ua_w_k * (1.0 + share),
            "G_out": ua_w_k * (1.0 + 1.0 / share),
        }
        for capacity, share in product(_WALL_CAPACITIES_J_K, _INNER_TIMES_OUTER)
    ]


_SLOW_BODY = (HiddenBy(BlindRuns.ROOM_STEADY_BODIES), HiddenBy(BlindRuns.SHORT, "extra_capacity"))
LOSS_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        wall_loss,
        (EffectParameter("UA", "W/K", 0.0, 100.0, 4.0),),
        source="thermal transmittance, ISO 6946",
        without="falls with T - T_amb: a warm box is predicted too warm, and ever more with the fan off",
        starts=({"UA": 1.0},),
        check="a heat flux plate on the wall",
    ),
    Effect(
        infiltration,
        (EffectParameter("F_inf", "m³/s", 0.0, 0.05, 0.002),),
        source="sensible infiltration load, ASHRAE Fundamentals 2017, ch. 16",
        without="falls with T - T_amb while the fan is off, and is gone while it runs",
        by_flow=True,
        starts=({"F_inf": 0.0005},),
        check="a run with the fan's openings taped",
        hidden_by=(HiddenBy(BlindRuns.FAN_OFF, "wall_loss"),),
    ),
    Effect(
        wall_mass,
        (
            EffectParameter("C_w", "J/K", 100.0, 1e6, 5000.0),
            EffectParameter("G_in", "W/K", 0.01, 500.0, 10.0),
            EffectParameter("G_out", "W/K", 0.01, 500.0, 8.0),
        ),
        source="two-state lumped wall (TiTe), Bacher & Madsen 2011, Energy and Buildings 43",
        without="negative when the box has just been warmed, positive for the hour after it cools",
        check="a thermometer on the wall",
        hidden_by=_SLOW_BODY,
        replaces="wall_loss",
        amounts_to=_films_in_series,
        starts_beside=_walls,
        time_constant=("C_w / G", lambda own: own["C_w"] / (own["G_in"] + own["G_out"])),
    ),
    Effect(
        soil_mass,
        (EffectParameter("C_s", "J/K", 100.0, 1e6, 10000.0), EffectParameter("G_s", "W/K", 0.01, 500.0, 3.0)),
        source="medium node (TiTm), Bacher & Madsen 2011, Energy and Buildings 43",
        without="follows the change of T over the last hours, and not the room: "
        "negative in the first warm hours, positive after they end, zero on average",
        starts=tuple({"C_s": c, "G_s": g} for c, g in product((3000.0, 30000.0), (1.5, 8.0))),
        check="a thermometer in the soil, or a run without the pots",
        hidden_by=_SLOW_BODY,
        time_constant=("C_s / G_s", lambda own: own["C_s"] / own["G_s"]),
        common=2,
    ),
    Effect(
        extra_capacity,
        (EffectParameter("kC", "", 1.0, 1000.0, 5.0, ParameterKind.AIR_CAPACITIES, nothing_at=1.0),),
        source="internal heat capacity of a zone, air and furniture, ISO 52016-1",
        without="the predicted temperature jumps where the measured one rises: "
        "opposite signs just after each switch",
        starts=({"kC": 1.5}, {"kC": 6.0}),
        check="a run with the box emptied",
    ),
    Effect(
        longwave_radiation,
        (EffectParameter("epsA", "m²", 0.0, 5.0, 0.3),),
        source="Stefan-Boltzmann law between a small grey body and its surroundings, ISO 6946 annex C",
        without="falls with T - T_amb, a little more than in proportion, and more in a warm room",
        starts=({"epsA": 0.1},),
        check="a foil with low emissivity on the outside for a run",
    ),
    Effect(
        door_opening,
        (EffectParameter("G_door", "W/K", 0.0, 500.0, 20.0),),
        source="single-sided air exchange through an opening, ASHRAE Fundamentals 2017, ch. 16",
        without="drops towards the room for minutes at times that no input tells, and comes back",
        offered_with=("door_open",),
        starts=({"G_door": 10.0},),
        check="a contact on the door",
    ),
    Effect(
        ua_drift,
        (EffectParameter("ua_drift", "1/d", -0.05, 0.5, 0.01),),
        source="ageing of seals and growth of a canopy, to first order",
        without="falls with T - T_amb, by a slope that changes from day to day",
        needs=("utc",),
        starts=({"ua_drift": 0.01},),
        check="the same run again after some days",
        hidden_by=(HiddenBy(BlindRuns.START_UNKNOWN), HiddenBy(BlindRuns.ONE_DAY)),
        counts_days=True,
    ),
)


# sensors, and heat that comes from neither heater nor fan


HOTTEST_LIFE_C = 40.0  # enzymes of plants and of most soil fail above


def sensor_lag(network: Network, tau_s: float) -> None:
    """A sensor that follows the air late: tau_s dT_m/dt = T - T_m."""
    network.sensor_lag_s = tau_s


def sensor_bias(network: Network, bias: float) -> None:
    """A sensor that shows too much: y = T + bias."""
    network.signals.sensor_bias_k = bias


def ambient_offset(network: Network, b_amb: float) -> None:
    """A room sensor that shows too much: T_amb measured = T_amb + b_amb."""
    network.signals.ambient_error_k = b_amb


def constant_heat(network: Network, P0: float) -> None:
    """Electronics, a neighbour, a pump: Q = P0."""
    network.heat(lambda now: np.full_like(now.ambient, P0))


def led_gain(network: Network, P_led: float) -> None:
    """The light's heat: Q = P_led L(t), L the column `light`."""
    network.heat(lambda now: P_led * now.column["light"])


def solar_gain(network: Network, A_sun: float) -> None:
    """Sun through windows: Q = A_sun I(t), I the column `solar` in W/m², A_sun what it is gathered by."""
    network.heat(lambda now: A_sun * now.column["solar"])


def evapotranspiration(network: Network, k_e: float) -> None:
    """Heat that plants and soil take to evaporate: Q = -k_e (0.4 + 0.6 L) VPD(T, RH), VPD in kPa.

    L is the column `light`, RH the column `rel_humidity` in %.
    """

    def flow(now: HeatConditions) -> Floats:
        open_share = 0.4 + 0.6 * now.column["light"]
        return -k_e * open_share * vapour_deficit_kpa(now.temp, now.column["rel_humidity"])

    network.heat(flow, by_temp=True)


def vapour_deficit_kpa(temp_c: Floats, rel_humidity: Floats) -> Floats:
    """Saturation pressure minus the vapour's; Tetens' formula, FAO 56 eq. 11; relative humidity in %."""
    saturation = 0.6108 * np.exp(17.27 * temp_c / (temp_c + 237.3))
    return np.asarray(saturation * (1.0 - rel_humidity / 100.0))


def respiration_heat(network: Network, P_res: float) -> None:
    """Living soil and plants breathe, twice as fast for each 10 K: Q = P_res 2^((T - 20) / 10).

    P_res is the heat at 20 °C; from 40 °C on the heat stays, as life does not stand more.
    """

    def flow(now: HeatConditions) -> Floats:
        warmth_k = np.minimum(now.temp, HOTTEST_LIFE_C) - 20.0
        return np.asarray(P_res * 2.0 ** (warmth_k / 10.0))

    network.heat(flow, by_temp=True)


SIGNAL_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        sensor_lag,
        (EffectParameter("tau_s", "s", 1.0, 3600.0, 60.0, ParameterKind.AIR_LAG),),
        source="first-order response of a temperature sensor, IEC 60751",
        without="lags every change, by heater, fan and room alike, by the same time",
        starts=({"tau_s": 20.0}, {"tau_s": 90.0}),
        check="a fast thermocouple beside the air sensor",
        common=3,
    ),
    Effect(
        sensor_bias,
        (EffectParameter("bias", "K", -5.0, 5.0, 0.3),),
        source="systematic error of measurement, JCGM 200 (VIM) 2.17",
        without="constant wherever the box has had time to settle, also at the room's temperature",
        starts=({"bias": 0.1},),
        check="a calibrated thermometer beside the air sensor",
        hidden_by=(HiddenBy(BlindRuns.ROOM_UNKNOWN, place=-1), HiddenBy(BlindRuns.ROOM_STEADY)),
    ),
    Effect(
        ambient_offset,
        (EffectParameter("b_amb", "K", -10.0, 10.0, 0.5),),
        source="systematic error of measurement, JCGM 200 (VIM) 2.17",
        without="constant wherever the box has had time to settle, more so with the fan on",
        starts=({"b_amb": 0.1},),
        check="an independent room sensor",
        hidden_by=(HiddenBy(BlindRuns.ROOM_UNKNOWN, place=-2), HiddenBy(BlindRuns.ROOM_STEADY, place=-1)),
    ),
    Effect(
        constant_heat,
        (EffectParameter("P0", "W", -50.0, 200.0, 5.0),),
        source="internal gain, ISO 52016-1",
        without="the same heat at all times: most in temperature while the fan is off",
        starts=({"P0": 1.0},),
        check="a power meter on all else that runs in the box",
        hidden_by=(HiddenBy(BlindRuns.ROOM_UNKNOWN), HiddenBy(BlindRuns.ROOM_STEADY, place=-2)),
        stands_in=True,
    ),
    Effect(
        led_gain,
        (EffectParameter("P_led", "W", 0.0, 300.0, 15.0),),
        source="heat gain from lighting, ASHRAE Fundamentals 2017, ch. 18",
        without="positive in proportion to the light",
        needs=("light",),
        starts=({"P_led": 2.0},),
        check="a power meter at the lamp",
        hidden_by=(HiddenBy(BlindRuns.LIGHT_STEADY),),
    ),
    Effect(
        solar_gain,
        (EffectParameter("A_sun", "m²", 0.0, 5.0, 0.05),),
        source="effective collecting area of a window, ISO 52016-1, 6.5.13",
        without="positive in proportion to the sun",
        needs=("solar",),
        starts=({"A_sun": 0.01},),
        check="a day with the windows covered",
    ),
    Effect(
        evapotranspiration,
        (EffectParameter("k_e", "W/kPa", 0.0, 200.0, 10.0),),
        source="latent heat by vapour pressure deficit and light, Stanghellini 1987",
        without="negative in dry, warm air, more so in the light",
        needs=("light", "rel_humidity"),
        starts=({"k_e": 2.0},),
        check="a run without plant and wet soil",
        hidden_by=(HiddenBy(BlindRuns.HUMIDITY_UNKNOWN),),
    ),
    Effect(
        respiration_heat,
        (EffectParameter("P_res", "W", 0.0, 50.0, 1.0),),
        source="heat of respiration, ASHRAE Refrigeration 2018, ch. 19; Q10 of 2, Lloyd & Taylor 1994",
        without="positive at all times, and twice as much in a box that is 10 K warmer",
        offer=Offer.KNOWN_ONLY,
        check="the rise of carbon dioxide in the closed box: 1 g/h is 3 W",
    ),
)


# rarer ones, which a thermal engineer would look for next


def fan_heat(network: Network, P_fan: float) -> None:
    """The motor's heat in the air it moves: Q = P_fan u_f."""
    network.heat(lambda now: P_fan * now.column["fan_on"])


def ground_loss(network: Network, G_g: float, T_g: float) -> None:
    """Heat into what the box stands on, at a temperature of its own: Q = -G_g (T - T_g)."""
    network.connect(AIR, ROOM, G_g)
    network.heat(lambda now: G_g * (T_g - now.ambient))


def stack_ventilation(network: Network, F_st: float) -> None:
    """Air that rises out of leaks, F_st at 10 K: Q = -rho c_p F_st sqrt(|T - T_amb| / 10) (T - T_amb)."""
    leak_w_k = network.geometry.volumetric_heat_j_m3_k * F_st
    _bent_loss(network, leak_w_k, exponent=0.5)


def natural_convection(network: Network, G_nc: float) -> None:
    """A film that thins in a warm box, G_nc at 10 K: Q = -G_nc (|T - T_amb| / 10)^(1/3) (T - T_amb)."""
    _bent_loss(network, G_nc, exponent=1.0 / 3.0)


def _bent_loss(network: Network, at_10_k_w_k: float, exponent: float) -> None:
    """Conductance that grows with a power of the difference; its value at 10 K is part of the network."""
    network.connect(AIR, ROOM, at_10_k_w_k)

    def beyond(now: HeatConditions) -> Floats:
        excess = now.temp - now.ambient
        return np.asarray(at_10_k_w_k * (1.0 - np.abs(excess / 10.0) ** exponent) * excess)

    network.heat(beyond, by_temp=True)


FURTHER_EFFECTS: Mapping[str, Effect] = by_name(
    Effect(
        fan_heat,
        (EffectParameter("P_fan", "W", 0.0, 100.0, 3.0),),
        source="heat gain of a motor in the airstream, ASHRAE Fundamentals 2017, ch. 18",
        without="positive with the fan on, whatever the temperature",
        offer=Offer.KNOWN_ONLY,
        stands_in=True,
        must_change=("fan_on",),
    ),
    Effect(
        ground_loss,
        (EffectParameter("G_g", "W/K", 0.0, 100.0, 1.0), EffectParameter("T_g", "°C", -10.0, 40.0, 15.0)),
        source="heat transfer via the ground, ISO 13370",
        without="falls with T, and stays where the room warms",
        offer=Offer.KNOWN_ONLY,
    ),
    Effect(
        stack_ventilation,
        (EffectParameter("F_st", "m³/s", 0.0, 0.05, 0.001),),
        source="stack effect through openings, ASHRAE Fundamentals 2017, ch. 16",
        without="falls with the power 1.5 of T - T_amb",
        offer=Offer.KNOWN_ONLY,
    ),
    Effect(
        natural_convection,
        (EffectParameter("G_nc", "W/K", 0.0, 100.0, 3.0),),
        source="turbulent natural convection at a wall, Nu ~ Ra^(1/3), Incropera & DeWitt, ch. 9",
        without="falls with the power 4/3 of T - T_amb",
        offer=Offer.KNOWN_ONLY,
        stands_in=True,
    ),
)
