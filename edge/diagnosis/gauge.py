"""From ratios to a twin file: what a grey box found, in watts and joules."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from edge.diagnosis.fit import GreyBox
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Effects = dict[str, dict[str, float]]
MOSTLY_RADIANT = 0.95  # share of a heater that stands behind a body: a fit begins inside the bound of 1
HEATS = {"light": ("led_gain", "P_led"), "solar": ("solar_gain", "A_sun"), "": ("constant_heat", "P0")}


class NamedValues(NamedTuple):
    """A twin file, and effects that it may lack with their values."""

    file: TwinFile
    effects: Effects

    def with_them(self) -> TwinFile:
        """Return the file with the effects, to be fitted from these values."""
        added = {
            name: {key: Value(value, fit=True) for key, value in own.items()}
            for name, own in self.effects.items()
        }
        return replace(self.file, effects={**self.file.effects, **added})


def in_watts(file: TwinFile, box: GreyBox, columns: Sequence[str]) -> tuple[TwinFile, list[Effects]]:
    """Return the file with its open values where the box has them, and effects that its terms may be.

    columns : names of what else heats in the box's gains, after the heater
    A log tells ratios alone: with the heater's power, which the file states or guesses, they become watts.
    """
    twin = file.twin()
    rates, power_w = box.rates, twin.geometry.heater_max_w
    capacity_j_k = power_w / max(abs(float(box.gains[0])), 1e-12)
    if "mantle" in box.terms:
        capacity_j_k *= rates["body_air"] / rates["air_body"]
    air_j_k = twin.geometry.air_capacity_j_k
    known = {place: value for place, value in file.values().items() if not value.fit}
    held: Mapping[str, Value] = file.effects.get("extra_capacity", {})
    if "kC" not in held or ("effects", "extra_capacity", "kC") in known:
        capacity_j_k = air_j_k * (held["kC"].value if "kC" in held else 1.0)
    flow_j_m3_k = twin.geometry.volumetric_heat_j_m3_k
    fan_w_k = flow_j_m3_k * twin.geometry.fan_max_m3_s
    direct_w_k, fanned_w_k = rates["loss"] * capacity_j_k, rates.get("fan", 0.0) * capacity_j_k
    wanted: dict[Place, float] = {
        ("effects", "extra_capacity", "kC"): capacity_j_k / air_j_k,
        ("effects", "wall_loss", "UA"): direct_w_k,
        ("effects", "fan_effectiveness", "eps_f"): fanned_w_k / fan_w_k,
        ("effects", "stirred_loss", "G_stir"): fanned_w_k,
    }
    values = file.values()
    moved = {
        place: replace(values[place], value=x)
        for place, x in wanted.items()
        if place in values and place not in known
    }
    others: Effects = {}
    for gain, column in zip(box.gains[1:], columns, strict=False):
        name, parameter = HEATS[column]
        others[name] = {parameter: float(gain) * capacity_j_k}
    lags: Effects = {}
    if "heater_lag" in box.terms:
        lags["heater_lag"] = {"tau_h": 1.0 / rates["heater"]}
    if "dead_time" in box.terms:
        lags["heater_deadtime"] = {"d_h": rates["dead_s"]}
    if "sensor_lag" in box.terms:
        lags["sensor_lag"] = {"tau_s": 1.0 / rates["sensor"]}
    return file.with_values(moved), [
        {**lags, **body, **others} for body in _bodies(box, capacity_j_k, direct_w_k, flow_j_m3_k)
    ]


def _bodies(box: GreyBox, capacity_j_k: float, direct_w_k: float, flow_j_m3_k: float) -> Iterator[Effects]:
    rates = box.rates
    if "air_body" not in rates:
        yield {}
        return
    inside_w_k = rates["air_body"] * capacity_j_k
    body_j_k = inside_w_k / rates["body_air"]
    soil = {"C_s": body_j_k, "G_s": inside_w_k}
    if "soil" in box.terms:
        yield {"soil_mass": soil}
        return
    if "mantle" in box.terms:
        yield {"soil_mass": soil, "radiative_split": {"f_rad": MOSTLY_RADIANT}}
        yield {"heater_lag": {"tau_h": 1.0 / rates["body_air"]}}
        return
    wall = {"C_w": body_j_k, "G_in": inside_w_k, "G_out": rates["body_room"] * body_j_k}
    yield {"wall_mass": wall}
    yield {"wall_mass": wall, "infiltration": {"F_inf": direct_w_k / flow_j_m3_k}}
    yield {"soil_mass": soil}
