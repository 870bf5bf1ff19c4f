"""Effects that the library has no name for: what the workflow must call unknown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.equations_inputs import Bend, Floats, OutsideConditions


@dataclass(frozen=True, slots=True)
class Outside:
    """An effect outside the library.

    bend : from its strength [B] and its further parameter
    low, high : strengths that are searched for a size; further : range of the further parameter
    depends_on : words of `cases.DEPENDENCES`, strongest first
    """

    bend: Callable[[Floats, float], Bend]
    low: float
    high: float
    depends_on: tuple[str, ...]
    further: tuple[float, float] = (0.0, 0.0)

    def draw_further(self, rng: Generator) -> float:
        """Draw the further parameter."""
        return float(rng.uniform(*self.further))


def sun_by_hour(peak_w: Floats, noon: float) -> Bend:
    """Sun through a window for four hours of the day, which no light sensor sees."""

    def heat(now: OutsideConditions) -> Floats:
        return peak_w * np.clip(1.0 - ((now.hour - noon) / 2.0) ** 2, 0.0, None)

    return Bend(heat_w=heat)


def sorption(watts: Floats, _: float) -> Bend:
    """Heat that falls with the humidity, per 10 %."""
    return Bend(heat_w=lambda now: -watts * (now.rel_humidity - 50.0) / 10.0)


def dew(watts: Floats, above: float) -> Bend:
    """Heat of condensation above a humidity, per 10 %."""
    return Bend(heat_w=lambda now: watts * np.clip(now.rel_humidity - above, 0.0, None) / 10.0)


def duty_with_fan(watts: Floats, _: float) -> Bend:
    """Heat that the fan blows past the air while the heater is hot: by the square of the duty."""
    return Bend(heat_w=lambda now: -watts * now.duty**2 * now.fan)


def thermostat(per_k: Floats, above_c: float) -> Bend:
    """Return a heater that gives less in hot air."""
    return Bend(power=lambda now: np.clip(1.0 - per_k * np.clip(now.air - above_c, 0.0, None), 0.0, 1.0))


def clogging(per_hour: Floats, _: float) -> Bend:
    """Return a filter that clogs: flow falls with the fan's hours in the run."""
    return Bend(flow=lambda now: np.exp(-per_hour * now.fan_hours))


def sensor_sees_heater(kelvin: Floats, _: float) -> Bend:
    """Return a reading that the heater's glow raises."""
    return Bend(reading=lambda now: kelvin * now.duty)


def square_loss(watts: Floats, _: float) -> Bend:
    """Loss by the square of the difference, at 10 K."""

    def heat(now: OutsideConditions) -> Floats:
        excess = now.air - now.room
        return -watts * excess * np.abs(excess) / 100.0

    return Bend(heat_w=heat)


def wax_vent(w_k: Floats, above_c: float) -> Bend:
    """Return a vent that opens by itself in hot air."""
    return Bend(heat_w=lambda now: -w_k * np.clip(now.air - above_c, 0.0, None))


def light_cubed(watts: Floats, _: float) -> Bend:
    """Return a lamp whose heat is not in proportion to its light."""
    return Bend(heat_w=lambda now: watts * now.light**3)


def chance_heat(watts: Floats, _: float) -> Bend:
    """Somebody else's heat: it follows nothing that is recorded."""
    return Bend(heat_w=lambda now: watts * now.chance)


def fan_when_warm(share: Floats, above_c: float) -> Bend:
    """Return a flap that sticks in a cool box: the fan moves less air below a temperature."""

    def flow(now: OutsideConditions) -> Floats:
        return 1.0 - share / (1.0 + np.exp(np.clip((now.air - above_c) / 0.4, -50.0, 50.0)))

    return Bend(flow=flow)


def reading_drifts(k_day: Floats, _: float) -> Bend:
    """Return a sensor that ages."""
    return Bend(reading=lambda now: k_day * now.day)


def timed_heat(watts: Floats, period_h: float) -> Bend:
    """Return a neighbour's machine that works at intervals."""
    return Bend(heat_w=lambda now: watts * (np.mod(now.hour, period_h) < 0.4 * period_h))


OUTSIDE: Mapping[str, Outside] = {
    "sun_by_hour": Outside(sun_by_hour, 1.0, 120.0, ("time",), (10.0, 15.0)),
    "sorption": Outside(sorption, 0.3, 60.0, ("rel_humidity",)),
    "dew": Outside(dew, 0.5, 100.0, ("rel_humidity",), (50.0, 58.0)),
    "duty_with_fan": Outside(duty_with_fan, 1.0, 60.0, ("heater_duty", "fan_on")),
    "thermostat": Outside(thermostat, 0.002, 0.3, ("temp_air", "heater_duty"), (24.0, 28.0)),
    "clogging": Outside(clogging, 0.03, 3.0, ("fan_on", "time")),
    "sensor_sees_heater": Outside(sensor_sees_heater, 0.1, 10.0, ("heater_duty",)),
    "square_loss": Outside(square_loss, 0.5, 80.0, ("temp_air", "temp_ambient")),
    "wax_vent": Outside(wax_vent, 0.1, 30.0, ("temp_air",), (24.0, 28.0)),
    "light_cubed": Outside(light_cubed, 0.5, 120.0, ("light",)),
    "chance_heat": Outside(chance_heat, 1.0, 60.0, ("none",)),
    "fan_when_warm": Outside(fan_when_warm, 0.03, 0.98, ("fan_on", "temp_air"), (23.0, 27.0)),
    "reading_drifts": Outside(reading_drifts, 0.01, 1.5, ("time",)),
    "timed_heat": Outside(timed_heat, 1.0, 60.0, ("time",), (0.7, 2.0)),
}
