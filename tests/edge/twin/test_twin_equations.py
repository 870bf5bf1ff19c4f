from itertools import combinations, product

import numpy as np
import pytest
import twin_equations

from edge.twin.effects.library import EFFECTS, UNNAMED_EFFECTS
from edge.twin.model import BoxTwin

STEPS = 25
LEAK = {"wall_loss": {"UA": 5.0}}
WALL = {"wall_mass": {"C_w": 8000.0, "G_in": 12.0, "G_out": 7.0}}
SOIL = {"soil_mass": {"C_s": 12000.0, "G_s": 3.0}}
SINGLE = {
    "infiltration": {"F_inf": 0.003},
    **WALL,
    **SOIL,
    "extra_capacity": {"kC": 4.0},
    "heater_lag": {"tau_h": 200.0},
    "heater_deadtime": {"d_h": 85.0},
    "heater_efficiency": {"eta": 0.8},
    "radiative_split": {"f_rad": 0.3},
    "heater_saturation": {"u_sat": 0.4},
    "heater_sag": {"sag": 0.2},
    "fan_effectiveness": {"eps_f": 0.7},
    "short_circuit": {"s_sc": 0.3},
    "stirred_loss": {"G_stir": 3.0},
    "blown_element": {"k_el": 2.0},
    "fan_deadtime": {"d_f": 25.0},
    "imperfect_mixing": {"F_mix": 0.01},
    "sensor_lag": {"tau_s": 90.0},
    "sensor_bias": {"bias": 0.7},
    "ambient_offset": {"b_amb": -1.2},
    "constant_heat": {"P0": 8.0},
    "led_gain": {"P_led": 20.0},
    "solar_gain": {"A_sun": 0.03},
    "door_opening": {"G_door": 25.0},
    "ua_drift": {"ua_drift": 0.05},
    "fan_heat": {"P_fan": 4.0},
    "ground_loss": {"G_g": 1.5, "T_g": 14.0},
}
SECOND_ORDER = {
    "fan_spinup": {"tau_f": 25.0},
    "longwave_radiation": {"epsA": 0.8},
    "evapotranspiration": {"k_e": 15.0},
    "stack_ventilation": {"F_st": 0.002},
    "natural_convection": {"G_nc": 2.0},
    "respiration_heat": {"P_res": 2.0},
    "heater_derating": {"k_P": 0.01},
}
EXACT_K, SECOND_ORDER_K, TWO_K, ZONES_K = 2e-6, 0.01, 0.02, 0.03  # as edge/twin/rollout.py states


def commands(seed, steps=STEPS):
    rng = np.random.default_rng(seed)
    fan = (rng.uniform(size=steps) < 0.4).astype(float)
    return rng.integers(0, 21, steps) / 20.0 * np.where(fan > 0.0, 1.0, 0.4), fan


def conditions(seed, steps=STEPS):
    """Room, light, humidity, time and door, as the equations name them and as the twin does."""
    rng = np.random.default_rng(seed)
    columns = {
        "ambient": 21.0 + rng.normal(size=steps),
        "light": rng.uniform(size=steps),
        "rel_humidity": rng.uniform(40.0, 80.0, steps),
        "solar": rng.uniform(0.0, 800.0, steps),
        "day": 2.0 + np.arange(steps) / 1440.0,
        "door": (rng.uniform(size=steps) < 0.2) * 1.0,
    }
    given = {name: columns[name] for name in ("light", "solar", "rel_humidity")}
    return columns, {**given, "utc": 86400.0 * columns["day"], "door_open": columns["door"]}


def difference(effects, seed=1):
    """Largest difference of a rollout to SciPy's [K]."""
    twin, (duty, fan), (columns, given) = (
        BoxTwin(effects=effects, day0_utc=0.0),
        commands(seed),
        conditions(seed),
    )
    start = dict.fromkeys(twin_equations.STATES, 26.0) | {"heater": 20.0, "fan": 0.0}
    bias = effects.get("sensor_bias", {}).get("bias", 0.0)
    state = np.array([start[name] + (0.0 if name == "heater" else bias) for name in twin.states])
    temps = twin.rollout(state, duty[None], fan[None], columns["ambient"], conditions=given)[0]
    return np.abs(temps - twin_equations.shown(effects, start, duty, fan, columns)).max()


def test_every_effect_is_compared_with_its_equation():
    assert {*LEAK, *SINGLE, *SECOND_ORDER} == set(EFFECTS) - set(UNNAMED_EFFECTS)  # which have no equation


@pytest.mark.parametrize("name", SINGLE)
def test_a_linear_effect_is_exact(name):
    beside = {} if name == "wall_mass" else LEAK
    assert difference({**beside, name: SINGLE[name]}) < EXACT_K


@pytest.mark.parametrize("name", SECOND_ORDER)
def test_an_effect_that_bends_is_within_its_stated_error(name):
    assert 0.0 < difference({**LEAK, name: SECOND_ORDER[name]}) < SECOND_ORDER_K


def test_all_linear_effects_together_are_exact():
    assert difference(SINGLE) < EXACT_K


BESIDE = ("heater_deadtime", "fan_deadtime", "imperfect_mixing")


@pytest.mark.parametrize(("name", "other"), [*combinations(SECOND_ORDER, 2), *product(SECOND_ORDER, BESIDE)])
def test_two_effects_are_within_their_stated_error(name, other):
    both = {**SINGLE, **SECOND_ORDER}
    found = difference({**LEAK, name: both[name], other: both[other]})
    assert found < (ZONES_K if other == "imperfect_mixing" else TWO_K)


def test_all_effects_together_are_within_the_stated_error():
    # in two zones the bend of both is taken at the sensor's, which the equations take at each
    assert difference({**SINGLE, **SECOND_ORDER}) < 2.0 * SECOND_ORDER_K
    one_zone = {name: values for name, values in SINGLE.items() if name != "imperfect_mixing"}
    assert difference({**one_zone, **SECOND_ORDER}) < SECOND_ORDER_K
