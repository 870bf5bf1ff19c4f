"""Named effects of sensors, and heat that comes from neither heater nor fan."""

from collections.abc import Mapping

import numpy as np

from edge.twin.effects.effect import (
    BlindRuns,
    Effect,
    EffectParameter,
    HiddenBy,
    Offer,
    ParameterKind,
    by_name,
)
from edge.twin.network import Network
from edge.twin.signals import Floats, HeatConditions

HOTTEST_LIFE_C = 40.0  # enzymes of plants and of most soil fail above


def sensor_lag(network: Network, tau_s: float) -> None:
    """A sensor that follows the air: tau_s dT_m/dt = T - T_m."""
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
