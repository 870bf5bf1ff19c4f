"""Named effects by which heat leaves the box or is stored in it."""

from collections.abc import Mapping
from itertools import product

from edge.twin.effects.effect import (
    BlindRuns,
    Effect,
    EffectParameter,
    HiddenBy,
    ParameterKind,
    UnitFactor,
    Values,
    by_name,
)
from edge.twin.network import AIR, ROOM, Network
from edge.twin.signals import Floats, HeatConditions

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
    """Soil and pots store heat: C_s dT_s/dt = G_s (T - T_s)."""
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
        # A light wall is a loss, and its capacity the air's.
        taken_apart=(("wall_loss", "extra_capacity"), ("wall_mass", "extra_capacity")),
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
        taken_apart=(("soil_mass", "extra_capacity"),),  # a light body is a capacity of the air
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
