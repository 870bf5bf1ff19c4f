"""Every switch of the chamber: its direction, and that scale 0 is absence."""

import dataclasses
import math
from collections.abc import Callable

import pytest
from test_chamber import PARAMETERS, QUIET, changed

from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import EFFECT_NAMES, LARGEST_SCALE, SIGNED, Effects

pytestmark = pytest.mark.slow

Scenario = Callable[[Chamber], None]


def heat(duration_s: float, duty: float = 1.0) -> Scenario:
    return lambda chamber: chamber.step(duration_s, duty, False, 0.0, False)


def heat_with_fan(chamber: Chamber) -> None:
    chamber.step(900.0, 1.0, True, 0.0, False)


def fan_after_heat(chamber: Chamber) -> None:
    chamber.step(900.0, 1.0, False, 0.0, False)
    chamber.step(6.0, 1.0, True, 0.0, False)


def rest(duration_s: float) -> Scenario:
    return lambda chamber: chamber.step(duration_s, 0.0, False, 0.0, False)


def lamp(chamber: Chamber) -> None:
    chamber.step(1800.0, 0.0, False, 1.0, False)


def run(parameters: ChamberParameters, scenario: Scenario, key: str, **scales: float) -> float:
    """Return the truth of `key` after the scenario; two zones differ by `stratification`."""
    chamber = Chamber(parameters, dataclasses.replace(QUIET, **scales), 1)
    scenario(chamber)
    truth = chamber.truth()
    truth["stratification"] = truth["temp_air_upper_c"] - truth["temp_air_lower_c"]
    sensed = {f"shown_{name}": value for name, value in chamber.sense().items()}
    return (truth | sensed)[key]


AIR = "temp_air_c"
CLOSED_WET_BOX = changed(room__rel_humidity_pct=90.0, air__leak_flow_m3_s=0.0)
# effect: does its growth raise (+1) or lower (-1) the value, after what, in which box
DIRECTIONS: list[tuple[str, int, str, Scenario, ChamberParameters]] = [
    ("wall_loss", -1, AIR, heat(1800), PARAMETERS),
    ("infiltration", -1, AIR, heat(1800), PARAMETERS),
    ("wall_mass", -1, AIR, heat(600), PARAMETERS),
    ("soil_mass", -1, AIR, heat(1800), PARAMETERS),
    ("extra_capacity", -1, AIR, heat(60), PARAMETERS),
    ("longwave_radiation", -1, AIR, heat(1800), PARAMETERS),
    ("evapotranspiration", -1, AIR, heat(1800), PARAMETERS),
    ("led_gain", +1, AIR, lamp, PARAMETERS),
    ("constant_heat", +1, AIR, rest(1800), PARAMETERS),
    ("door_opening", -1, AIR, heat(1800), changed(events__door_interval_s=300.0)),
    ("ua_drift", -1, AIR, heat(1800), changed(room__start_day=30.0)),
    ("heater_lag", -1, AIR, heat(120), PARAMETERS),
    ("heater_deadtime", -1, AIR, heat(60), PARAMETERS),
    ("heater_efficiency", -1, AIR, heat(1800), PARAMETERS),
    ("radiative_split", -1, AIR, heat(1800), PARAMETERS),
    ("heater_saturation", -1, AIR, heat(1800), PARAMETERS),
    ("heater_sag", -1, AIR, heat(1800), PARAMETERS),
    ("fan_effectiveness", +1, AIR, heat_with_fan, PARAMETERS),
    ("short_circuit", +1, AIR, heat_with_fan, PARAMETERS),
    ("fan_deadtime", +1, AIR, fan_after_heat, PARAMETERS),
    ("fan_spinup", +1, AIR, fan_after_heat, PARAMETERS),
    ("imperfect_mixing", +1, "stratification", heat(1800), PARAMETERS),
    ("sensor_lag", -1, "temp_sensor_c", heat(120), PARAMETERS),
    ("sensor_bias", +1, "shown_temp_air_c", rest(60), PARAMETERS),
    ("sensor_bias", +1, "shown_rel_humidity_pct", rest(60), PARAMETERS),
    ("ambient_offset", +1, "shown_temp_ambient_c", rest(60), PARAMETERS),
    ("ambient_diurnal", +1, "temp_ambient_c", rest(60), changed(room__start_hour=16.0)),
    ("ambient_diurnal", -1, "temp_ambient_c", rest(60), changed(room__start_hour=4.0)),
    ("natural_convection", -1, AIR, heat(3600), PARAMETERS),
    ("interior_longwave", +1, "temp_soil_c", heat(3600), PARAMETERS),
    ("plant_mass", -1, "temp_plant_c", heat(300), PARAMETERS),
    ("condensation", -1, "vapour_g_m3", lamp, CLOSED_WET_BOX),
    ("condensation", +1, "temp_cover_outer_c", lamp, CLOSED_WET_BOX),
    ("fan_motor_heat", +1, AIR, heat_with_fan, PARAMETERS),
    ("sun_window", +1, AIR, rest(1800), changed(room__start_hour=10.5)),
    ("heater_thermostat", -1, AIR, heat(3600), PARAMETERS),
    ("fan_clogging", +1, AIR, heat_with_fan, changed(fan__clogging_per_day=20.0)),
    ("stack_ventilation", -1, AIR, heat(1800), PARAMETERS),
    ("sensor_radiation", +1, "temp_sensor_c", heat(600), PARAMETERS),
    ("sensor_drift", +1, "shown_temp_air_c", rest(7200), changed(sensors__air_drift_k_day=3.0)),
]
# These have no direction: they make runs differ.
RANDOM = (
    "ambient_wander", "power_run_variation", "power_wander", "sensor_noise", "sensor_step", "room_draught",
    "heat_noise",
)  # fmt: skip


@pytest.mark.parametrize("effect, sign, key, scenario, parameters", DIRECTIONS)
def test_an_effect_works_in_its_direction_and_more_of_it_works_more(effect, sign, key, scenario, parameters):
    absent, present, twice = (run(parameters, scenario, key, **{effect: scale}) for scale in (0.0, 1.0, 2.0))
    assert sign * (present - absent) > 1e-3
    assert sign * (twice - present) > 1e-3


@pytest.mark.parametrize("effect", RANDOM)
def test_a_random_effect_makes_a_difference(effect):
    base = QUIET if effect == "sensor_step" else dataclasses.replace(QUIET, sensor_step=0.0)

    def shown(scale: float) -> list[float]:
        chamber, values = Chamber(PARAMETERS, dataclasses.replace(base, **{effect: scale}), 1), []
        for _ in range(30):
            chamber.step(60.0, 0.5, False, 0.0, False)
            values.append(chamber.sense()["temp_air_c"])
        return values

    differences = [abs(a - b) for a, b in zip(shown(0.0), shown(1.0), strict=True)]
    assert 1e-3 < max(differences) < 2.0


def test_every_effect_has_its_test():
    assert {effect for effect, *_ in DIRECTIONS} | set(RANDOM) == set(EFFECT_NAMES)


# What an effect's size is written in: with the effect absent its parameters must not matter at all.
OWN_PARAMETERS = {
    "wall_loss": ("cover__outer_film_w_m2_k", "soil__floor_w_k"),
    "infiltration": ("air__leak_flow_m3_s",),
    "soil_mass": ("soil__capacity_j_k",),
    "extra_capacity": ("air__contact_capacity_factor",),
    "longwave_radiation": ("cover__emissivity",),
    "evapotranspiration": ("soil__evaporation_w_kpa", "plant__transpiration_w_kpa", "plant__dark_share"),
    "constant_heat": ("events__constant_heat_w",),
    "door_opening": ("events__door_w_k", "events__door_interval_s"),
    "ua_drift": ("cover__ua_drift_per_day",),
    "heater_lag": ("heater__capacity_j_k",),
    "heater_deadtime": ("heater__deadtime_s",),
    "heater_efficiency": ("heater__efficiency",),
    "heater_saturation": ("heater__saturation_duty",),
    "heater_sag": ("heater__sag",),
    "fan_effectiveness": ("fan__effectiveness",),
    "short_circuit": ("fan__short_circuit",),
    "fan_deadtime": ("fan__deadtime_s",),
    "fan_spinup": ("fan__spinup_s",),
    "imperfect_mixing": ("air__mixing_flow_m3_s", "air__fan_mixing_flow_m3_s"),
    "sensor_lag": ("sensors__air_lag_s", "sensors__humidity_lag_s", "sensors__co2_lag_s"),
    "sensor_bias": ("sensors__air_bias_k", "sensors__humidity_bias_pct"),
    "ambient_offset": ("sensors__ambient_offset_k",),
    "sensor_noise": ("sensors__air_noise_k", "sensors__ambient_noise_k", "sensors__co2_noise_ppm"),
    "sensor_step": ("sensors__temp_step_k", "sensors__humidity_step_pct"),
    "ambient_diurnal": ("room__diurnal_k",),
    "ambient_wander": ("room__wander_sd_k", "room__humidity_wander_pct", "room__co2_wander_ppm"),
    "power_run_variation": ("mains__run_sd",),
    "power_wander": ("mains__wander_sd",),
    "natural_convection": ("cover__film_reference_k",),
    "interior_longwave": ("soil__longwave_m2",),
    "plant_mass": ("plant__capacity_j_k",),
    "fan_motor_heat": ("fan__motor_heat_w",),
    "sun_window": ("room__sun_w", "room__sun_light"),
    "heater_thermostat": ("heater__thermostat_share_per_k", "heater__thermostat_c"),
    "room_draught": ("cover__draught_share", "cover__draught_tau_s"),
    "fan_clogging": ("fan__clogging_per_day",),
    "stack_ventilation": ("air__stack_leak_flow_m3_s",),
    "sensor_radiation": ("sensors__radiation_k_w",),
    "sensor_drift": ("sensors__air_drift_k_day",),
    "heat_noise": ("events__heat_noise_w", "events__heat_noise_tau_s"),
}
EVERYTHING = dataclasses.replace(Effects(**dict.fromkeys(EFFECT_NAMES, 1.0)), sensor_step=0.0)


def course(parameters: ChamberParameters, effects: Effects) -> list[dict[str, float]]:
    """A run that excites everything: heat, lamp and sun, fan, two days of age."""
    chamber, rows = Chamber(parameters, effects, 3), []
    for minutes, duty, fan, led in ((8, 1.0, False, 0.5), (2, 1.0, True, 0.0), (4, 0.9, False, 0.0)):
        for _ in range(minutes):
            chamber.step(60.0, duty, fan, led, False)
            rows.append(chamber.truth() | {f"shown_{k}": v for k, v in chamber.sense().items()})
    return rows


@pytest.mark.parametrize("effect", OWN_PARAMETERS)
def test_an_absent_effect_leaves_no_trace_and_a_present_one_does(effect):
    base = {"room__start_hour": 10.9, "room__start_day": 2.0, "events__door_interval_s": 240.0}
    base["heater__thermostat_c"] = 90.0
    parameters = changed(**base)
    scales = {"evapotranspiration": 0.0} if effect in ("soil_mass", "plant_mass") else {}
    step = {"sensor_step": 1.0} if effect == "sensor_step" else {}
    present = dataclasses.replace(EVERYTHING, **scales, **step)
    absent = dataclasses.replace(EVERYTHING, **scales | {effect: 0.0})
    without, whole = course(parameters, absent), course(parameters, present)
    for name in OWN_PARAMETERS[effect]:
        section, key = name.split("__")
        value = getattr(getattr(parameters, section), key)
        other = changed(**base | {name: value * 0.8})
        assert course(other, absent) == without
        assert course(other, present) != whole


def test_no_mass_is_the_limit_of_little_mass():
    for effect in ("heater_lag", "wall_mass", "soil_mass", "plant_mass"):
        dry = dataclasses.replace(QUIET, evapotranspiration=0.0, condensation=0.0)
        little, none = (
            course(PARAMETERS, dataclasses.replace(dry, **{effect: scale})) for scale in (1e-3, 0.0)
        )
        assert max(abs(a[AIR] - b[AIR]) for a, b in zip(little, none, strict=True)) < 0.1


def test_two_zones_become_one_as_the_exchange_grows():
    little, none = (run(PARAMETERS, heat(1800), AIR, imperfect_mixing=scale) for scale in (1e-3, 0.0))
    assert little == pytest.approx(none, abs=0.01)
    assert run(PARAMETERS, heat(1800), "stratification", imperfect_mixing=0.0) < 1e-3


def test_saturation_and_sag_see_the_duty_of_a_pulsed_relay():
    def heat_w(pulsed: bool, **scales: float) -> float:
        parameters = changed(heater__duty_window_s=20.0 if pulsed else 0.0)
        chamber = Chamber(parameters, dataclasses.replace(QUIET, heater_efficiency=0.0, **scales), 0)
        for _ in range(90):
            if pulsed:
                chamber.step(18.0, 1.0, False, 0.0, False)
                chamber.step(2.0, 0.0, False, 0.0, False)
            else:
                chamber.step(20.0, 0.9, False, 0.0, False)
        return chamber.energy()["heater_in_j"] / 1800.0

    # H_max min(u, 0.8) and H_max u (1 - 0.08 u) at u = 0.9
    assert heat_w(False, heater_saturation=1.0) == pytest.approx(80.0)
    assert heat_w(True, heater_saturation=1.0) == pytest.approx(80.0, rel=0.01)
    assert heat_w(False, heater_sag=1.0) == pytest.approx(90.0 * (1.0 - 0.08 * 0.9))
    assert heat_w(True, heater_sag=1.0) == pytest.approx(90.0 * (1.0 - 0.08 * 0.9), rel=0.01)


def test_dead_times_end_when_they_should():
    chamber = Chamber(PARAMETERS, dataclasses.replace(QUIET, heater_deadtime=1.0, fan_deadtime=1.0), 0)
    delay_s = PARAMETERS.heater.deadtime_s
    chamber.step(delay_s, 1.0, True, 0.0, False)
    assert chamber.energy()["heater_in_j"] == pytest.approx(0.0, abs=1e-3)
    chamber.step(10.0, 0.0, False, 0.0, False)
    assert chamber.energy()["heater_in_j"] == pytest.approx(970.0, rel=1e-6)
    chamber.step(20.0, 0.0, False, 0.0, False)
    assert chamber.energy()["heater_in_j"] == pytest.approx(970.0 * delay_s / 10.0, rel=1e-6)


def test_longwave_loss_goes_with_the_fourth_power():
    effects = Effects.none(longwave_radiation=1.0, heater_lag=1.0)
    chamber = Chamber(PARAMETERS, effects, 0)
    chamber.step(3 * 3600.0, 1.0, False, 0.0, False)
    truth = chamber.truth()
    fourth = (truth["temp_cover_outer_c"] + 273.15) ** 4 - (truth["temp_ambient_c"] + 273.15) ** 4
    assert 1.45 * 0.9 * 5.670374e-8 * fourth == pytest.approx(100.0, rel=1e-4)


def test_the_run_to_run_power_varies_by_the_stated_share():
    powers = []
    for seed in range(200):
        chamber = Chamber(PARAMETERS, dataclasses.replace(QUIET, power_run_variation=1.0), seed)
        chamber.step(1.0, 1.0, False, 0.0, False)
        powers.append(chamber.energy()["heater_in_j"] / 97.0 - 1.0)
    spread = math.sqrt(sum(power**2 for power in powers) / len(powers))
    assert spread == pytest.approx(PARAMETERS.mains.run_sd, rel=0.2)


@pytest.mark.parametrize("scale", [math.nan, math.inf, -0.1, LARGEST_SCALE + 1e-6, True, "1", None])
def test_a_wrong_scale_is_refused(scale):
    with pytest.raises(ValueError, match=r"effects\.wall_loss"):
        Effects(wall_loss=scale)


@pytest.mark.parametrize("name", sorted(SIGNED))
def test_effects_of_two_signs_take_both(name):
    assert getattr(Effects(**{name: -LARGEST_SCALE}), name) == -LARGEST_SCALE
    with pytest.raises(ValueError, match=name):
        Effects(**{name: -LARGEST_SCALE - 1e-6})


def test_the_vocabulary_of_the_twin_is_covered():
    assert set(EFFECT_NAMES) >= {
        "wall_loss", "infiltration", "wall_mass", "soil_mass", "extra_capacity", "heater_lag",
        "heater_deadtime", "heater_efficiency", "radiative_split", "heater_saturation", "heater_sag",
        "longwave_radiation", "fan_effectiveness", "short_circuit", "fan_deadtime", "fan_spinup",
        "imperfect_mixing", "sensor_lag", "sensor_bias", "ambient_offset", "constant_heat", "led_gain",
        "evapotranspiration", "door_opening", "ua_drift",
    }  # fmt: skip
