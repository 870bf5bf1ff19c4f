"""Named effects of sensors, and heat that comes from neither heater nor fan."""

from collections.abc import Mapping

import numpy as np

from edge.twin.effects.effect import Effect, EffectParameter
from edge.twin.network import Network
from edge.twin.signals import Floats, HeatConditions


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

    def taken(now: HeatConditions) -> Floats:
        open_share = 0.4 + 0.6 * now.column["light"]
        return -k_e * open_share * vapour_deficit_kpa(now.temp, now.column["rel_humidity"])

    network.heat(taken, by_temp=True)


def vapour_deficit_kpa(temp_c: Floats, rel_humidity: Floats) -> Floats:
    """Saturation pressure minus the vapour's; Tetens' formula, FAO 56 eq. 11; relative humidity in %."""
    saturation = 0.6108 * np.exp(17.27 * temp_c / (temp_c + 237.3))
    return np.asarray(saturation * (1.0 - rel_humidity / 100.0))


SIGNAL_EFFECTS: Mapping[str, Effect] = {
    "sensor_lag": Effect(
        sensor_lag,
        (EffectParameter("tau_s", "s", 1.0, 3600.0, 60.0),),
        "first-order response of a temperature sensor, IEC 60751",
        "lags every change, by heater, fan and room alike, by the same time",
    ),
    "sensor_bias": Effect(
        sensor_bias,
        (EffectParameter("bias", "K", -5.0, 5.0, 0.3),),
        "systematic error of measurement, JCGM 200 (VIM) 2.17",
        "constant wherever the box has had time to settle, also at the room's temperature",
    ),
    "ambient_offset": Effect(
        ambient_offset,
        (EffectParameter("b_amb", "K", -10.0, 10.0, 0.5),),
        "systematic error of measurement, JCGM 200 (VIM) 2.17",
        "constant wherever the box has had time to settle, more so with the fan on",
    ),
    "constant_heat": Effect(
        constant_heat,
        (EffectParameter("P0", "W", -50.0, 200.0, 5.0),),
        "internal gain, ISO 52016-1",
        "the same heat at all times: most in temperature while the fan is off",
    ),
    "led_gain": Effect(
        led_gain,
        (EffectParameter("P_led", "W", 0.0, 300.0, 15.0),),
        "heat gain from lighting, ASHRAE Fundamentals 2017, ch. 18",
        "positive in proportion to the light",
        needs=("light",),
    ),
    "solar_gain": Effect(
        solar_gain,
        (EffectParameter("A_sun", "m²", 0.0, 5.0, 0.05),),
        "effective collecting area of a window, ISO 52016-1, 6.5.13",
        "positive in proportion to the sun",
        needs=("solar",),
    ),
    "evapotranspiration": Effect(
        evapotranspiration,
        (EffectParameter("k_e", "W/kPa", 0.0, 200.0, 10.0),),
        "latent heat by vapour pressure deficit and light, Stanghellini 1987",
        "negative in dry, warm air, more so in the light",
        needs=("light", "rel_humidity"),
    ),
}
