"""Random boxes: which effects a box has, how large each is, and effects that the library has no name for.

What is in `OUTSIDE` the workflow must call unknown.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.inputs import Bend, Floats, OutsideConditions

Effects = dict[str, dict[str, float]]
MOST_OPTIONAL = 3
LIT = ("led_gain", "evapotranspiration")


class Strength(NamedTuple):
    """The parameter that makes an effect stronger: searched from `low` to
    `high`; `usual` is that of known ones.

    form : the parameter is the strength ("same"), 1 minus it ("rest"), 1 over it ("inverse")
    """

    parameter: str
    low: float
    high: float
    usual: tuple[float, float]
    form: str = "same"
    signed: bool = False

    def value(self, strength: float) -> float:
        """Return the parameter."""
        return {"same": strength, "rest": 1.0 - strength, "inverse": 1.0 / strength}[self.form]


STRENGTHS: Mapping[str, Strength] = {
    "wall_loss": Strength("UA", 0.05, 8.0, (3.0, 6.0)),
    "infiltration": Strength("F_inf", 5e-5, 0.008, (0.0005, 0.002)),
    "wall_mass": Strength("C_w", 500.0, 60000.0, (4000.0, 20000.0)),
    "soil_mass": Strength("C_s", 500.0, 80000.0, (5000.0, 25000.0)),
    "extra_capacity": Strength("kC", 1.1, 15.0, (1.5, 6.0)),
    "heater_lag": Strength("tau_h", 10.0, 1500.0, (60.0, 400.0)),
    "heater_deadtime": Strength("d_h", 5.0, 300.0, (20.0, 60.0)),
    "heater_efficiency": Strength("eta", 0.005, 0.5, (0.03, 0.15), "rest"),
    "radiative_split": Strength("f_rad", 0.01, 0.8, (0.15, 0.4)),
    "heater_saturation": Strength("u_sat", 0.02, 0.8, (0.1, 0.3), "rest"),
    "heater_sag": Strength("sag", 0.005, 0.45, (0.05, 0.15)),
    "longwave_radiation": Strength("epsA", 0.01, 1.5, (0.1, 0.4)),
    "fan_effectiveness": Strength("eps_f", 0.02, 0.9, (0.15, 0.4), "rest"),
    "short_circuit": Strength("s_sc", 0.02, 0.9, (0.1, 0.3)),
    "fan_deadtime": Strength("d_f", 3.0, 240.0, (10.0, 40.0)),
    "fan_spinup": Strength("tau_f", 3.0, 240.0, (10.0, 40.0)),
    "imperfect_mixing": Strength("F_mix", 3.0, 2000.0, (30.0, 100.0), "inverse"),
    "sensor_lag": Strength("tau_s", 5.0, 900.0, (20.0, 90.0)),
    "sensor_bias": Strength("bias", 0.05, 4.0, (0.2, 0.8), signed=True),
    "ambient_offset": Strength("b_amb", 0.05, 5.0, (0.2, 0.8), signed=True),
    "constant_heat": Strength("P0", 0.2, 40.0, (2.0, 8.0)),
    "led_gain": Strength("P_led", 0.3, 80.0, (10.0, 25.0)),
    "evapotranspiration": Strength("k_e", 0.1, 50.0, (2.0, 6.0)),
    "door_opening": Strength("G_door", 0.5, 300.0, (10.0, 30.0)),
    "ua_drift": Strength("ua_drift", 0.001, 0.5, (0.01, 0.03)),
}
OPTIONAL = {
    "heater_lag": 0.35, "fan_effectiveness": 0.4, "soil_mass": 0.25, "infiltration": 0.25,
    "heater_efficiency": 0.25, "sensor_lag": 0.2, "longwave_radiation": 0.1, "radiative_split": 0.1,
    "constant_heat": 0.1, "led_gain": 0.1, "imperfect_mixing": 0.05,
}  # fmt: skip
BARE_OPTIONAL = {
    **OPTIONAL, "evapotranspiration": 0.1, "ambient_offset": 0.15, "sensor_bias": 0.1, "heater_sag": 0.1,
    "heater_saturation": 0.1, "heater_deadtime": 0.1, "fan_deadtime": 0.05,
}  # fmt: skip
# Pairs whose shares no data can tell, or nearly so.
ALIKE = (
    {"fan_effectiveness", "short_circuit"},
    {"fan_deadtime", "fan_spinup"},
    {"heater_deadtime", "heater_lag"},
    {"heater_efficiency", "heater_sag"},
    {"heater_sag", "heater_saturation"},
    {"heater_efficiency", "radiative_split"},
    {"wall_loss", "longwave_radiation"},
    {"infiltration", "longwave_radiation"},
    {"constant_heat", "ambient_offset"},
    {"constant_heat", "sensor_bias"},
    {"sensor_bias", "ambient_offset"},
    {"sensor_lag", "extra_capacity"},
    {"sensor_lag", "imperfect_mixing"},
    {"heater_lag", "imperfect_mixing"},
    {"evapotranspiration", "constant_heat"},
    {"wall_loss", "wall_mass"},
)


def are_alike(names: set[str]) -> bool:
    """Return whether two of them can hardly be told apart."""
    return any(pair <= names for pair in ALIKE)


def draw_effect(rng: Generator, name: str) -> dict[str, float]:
    """Draw an effect of the usual size."""
    strength = STRENGTHS[name]
    return size_effect(draw_others(rng, name), name, rng.uniform(*strength.usual))


def draw_others(rng: Generator, name: str) -> dict[str, float]:
    """Draw the part of an effect that does not depend on its strength; its sign is under ""."""
    if name == "wall_mass":
        return {"G_in": rng.uniform(6.0, 14.0), "G_out": rng.uniform(6.0, 12.0)}
    if name == "soil_mass":
        return {"G_s": rng.uniform(1.5, 5.0)}
    return {"": 1.0 if rng.random() < 0.5 else -1.0} if STRENGTHS[name].signed else {}


def size_effect(others: Mapping[str, float], name: str, strength: float) -> dict[str, float]:
    """All parameters, the main one first."""
    main = STRENGTHS[name]
    value = others.get("", 1.0) * main.value(strength)
    return {main.parameter: float(value), **{key: item for key, item in others.items() if key}}


def draw_box(rng: Generator, hidden: Mapping[str, Mapping[str, float]]) -> Effects:
    """Draw a box's effects without the hidden ones: those that the twin file knows.

    hidden : by name, what does not depend on its strength (`draw_others`)
    """
    effects = _walls(rng, hidden)
    if "extra_capacity" not in hidden:
        effects["extra_capacity"] = draw_effect(rng, "extra_capacity")
    wanted = [name for name, odds in OPTIONAL.items() if rng.random() < odds]
    rng.shuffle(wanted)
    for name in wanted[:MOST_OPTIONAL]:
        if name not in effects and _fits(name, set(hidden), effects):
            effects[name] = draw_effect(rng, name)
    return effects


def _fits(name: str, hidden: set[str], effects: Effects) -> bool:
    """Return whether a known effect makes sense together with the hidden ones."""
    if name in hidden or are_alike({name, *hidden}):
        return False
    return name != "radiative_split" or bool({"wall_mass", "soil_mass"} & set(effects))


def _walls(rng: Generator, hidden: Mapping[str, Mapping[str, float]]) -> Effects:
    """Draw the walls' loss; where the walls' mass is hidden the known loss is without it."""
    if "wall_loss" in hidden:  # what is known is another way out
        return {"longwave_radiation": {"epsA": rng.uniform(0.5, 0.9)}}
    if "wall_mass" in hidden:
        return {"wall_loss": {"UA": series(hidden["wall_mass"])}}
    if "radiative_split" in hidden or rng.random() < 0.5:
        return {"wall_mass": draw_effect(rng, "wall_mass")}
    return {"wall_loss": draw_effect(rng, "wall_loss")}


def series(wall: Mapping[str, float]) -> float:
    """UA of a wall with mass at rest [W/K]."""
    return 1.0 / (1.0 / wall["G_in"] + 1.0 / wall["G_out"])


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
