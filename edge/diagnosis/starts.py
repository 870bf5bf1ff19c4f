"""From where a candidate effect is fitted: several sets of values where a likelihood has several tops."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from edge.twin.effects.library import EFFECTS
from edge.twin.scale import USUAL_STEP_S
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

Values = Mapping[str, float]
# The likelihood of a dead time has a top in each row that it can end in: usually rows are a minute.
DEAD_TIMES_S = (15.0, 45.0, 80.0, 140.0, 200.0, 260.0)
# Near none of the effect where its size may be 0, else over the scales on which it can be seen at all.
STARTS: Mapping[str, Sequence[Values]] = {
    "wall_loss": ({"UA": 1.0},),
    "infiltration": ({"F_inf": 0.0005},),
    "soil_mass": tuple({"C_s": c, "G_s": g} for c, g in product((3000.0, 30000.0), (1.5, 8.0))),
    "extra_capacity": ({"kC": 1.5}, {"kC": 6.0}),
    "longwave_radiation": ({"epsA": 0.1},),
    "door_opening": ({"G_door": 10.0},),
    "ua_drift": ({"ua_drift": 0.01},),
    "heater_lag": ({"tau_h": 40.0}, {"tau_h": 180.0}, {"tau_h": 700.0}),
    "heater_deadtime": tuple({"d_h": seconds} for seconds in DEAD_TIMES_S),
    "heater_efficiency": ({"eta": 0.95},),
    "radiative_split": ({"f_rad": 0.1},),
    "heater_saturation": ({"u_sat": 0.9}, {"u_sat": 0.7}, {"u_sat": 0.5}),
    "heater_sag": ({"sag": 0.05},),
    "fan_effectiveness": ({"eps_f": 0.95},),
    "short_circuit": ({"s_sc": 0.05},),
    "fan_deadtime": tuple({"d_f": seconds} for seconds in DEAD_TIMES_S),
    "fan_spinup": ({"tau_f": 10.0}, {"tau_f": 40.0}),
    "imperfect_mixing": ({"F_mix": 0.004}, {"F_mix": 0.02}, {"F_mix": 0.1}),
    "sensor_lag": ({"tau_s": 20.0}, {"tau_s": 90.0}),
    "sensor_bias": ({"bias": 0.1},),
    "ambient_offset": ({"b_amb": 0.1},),
    "constant_heat": ({"P0": 1.0},),
    "led_gain": ({"P_led": 2.0},),
    "solar_gain": ({"A_sun": 0.01},),
    "evapotranspiration": ({"k_e": 2.0},),
}
WALL_CAPACITIES_J_K = (2000.0, 20000.0)
INNER_TIMES_OUTER = (0.4, 2.5)  # of the two films of a wall whose loss as a whole is known
USUAL_UA_W_K = 4.0  # where it is not


def with_usual(file: TwinFile, name: str) -> TwinFile:
    """The file with one more effect, to be fitted, from its usual values."""
    return _added(
        file,
        name,
        {item.name: file.usual(("effects", name, item.name)).start for item in EFFECTS[name].parameters},
    )


def with_effect(file: TwinFile, name: str) -> list[TwinFile]:
    """The file with one more effect, to be fitted, from each of its starts."""
    if name == "wall_mass":
        return [_added(file, name, values) for values in _walls(file)]
    if name not in STARTS:
        return [with_usual(file, name)]
    return [_added(file, name, _scaled(file, name, values)) for values in STARTS[name]]


def _scaled(file: TwinFile, name: str, values: Values) -> Values:
    """Of the paper's box, for this one."""
    if name in ("heater_deadtime", "fan_deadtime"):
        return {key: value * file.sample_s / USUAL_STEP_S for key, value in values.items()}
    effect, scale = EFFECTS[name], file.scale
    return {key: value * scale.of(effect.parameter(key).unit) for key, value in values.items()}


def _walls(file: TwinFile) -> list[Values]:
    """Films that give the known loss in series."""
    known = file.effects.get("wall_loss", {}).get("UA")
    scale = file.scale
    ua_w_k = known.value if known is not None and known.value > 0.0 else USUAL_UA_W_K * scale.of("W/K")
    return [
        {
            "C_w": capacity * scale.of("J/K"),
            "G_in": ua_w_k * (1.0 + share),
            "G_out": ua_w_k * (1.0 + 1.0 / share),
        }
        for capacity, share in product(WALL_CAPACITIES_J_K, INNER_TIMES_OUTER)
    ]


def _added(file: TwinFile, name: str, values: Values) -> TwinFile:
    return replace(
        file,
        effects={**file.effects, name: {key: Value(value, fit=True) for key, value in values.items()}},
    )


def settled(file: TwinFile) -> TwinFile:
    """The file with its values as they are, none to be fitted."""
    return file.with_values({place: Value(value.value) for place, value in file.values().items()})
