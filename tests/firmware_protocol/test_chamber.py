"""The simulated greenhouse as a whole: balances, directions, sensors, steps."""

import dataclasses
import itertools
import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol.virtual_board import chamber as chamber_module
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, load
from firmware_protocol.virtual_board.effects import EFFECT_NAMES, LARGEST_SCALE, Effects

pytestmark = pytest.mark.slow

PARAMETERS, DEFAULT_SET = load()
QUIET = dataclasses.replace(
    DEFAULT_SET,
    ambient_diurnal=0.0, ambient_wander=0.0, power_run_variation=0.0, power_wander=0.0, sensor_noise=0.0,
    sensor_bias=0.0, ambient_offset=0.0,
)  # fmt: skip
ROOM_C = PARAMETERS.room.temp_c


def changed(**keys: float) -> ChamberParameters:
    """The default parameters with `section__key` replaced."""
    parameters = PARAMETERS
    for name, value in keys.items():
        section, key = name.split("__")
        part = dataclasses.replace(getattr(parameters, section), **{key: value})
        parameters = dataclasses.replace(parameters, **{section: part})
    return parameters


def warm_box(effects: Effects = QUIET, seed: int = 1) -> Chamber:
    chamber = Chamber(PARAMETERS, effects, seed)
    chamber.step(1800.0, 1.0, False, 0.0, False)
    return chamber


def test_energy_in_is_energy_out_plus_stored():
    every = Effects.from_mapping({name: 1.0 for name in EFFECT_NAMES})
    for effects in (DEFAULT_SET, every, dataclasses.replace(every, wall_mass=0.0, heater_lag=0.0)):
        chamber = Chamber(PARAMETERS, effects, 3)
        for minute in range(120):
            duty, fan = 0.25 * (minute // 10 % 5), minute // 7 % 3 == 0
            chamber.step(60.0, duty, fan, 0.5, minute == 20)
        energy = chamber.energy()
        assert energy["in_j"] > 100e3
        assert abs(energy["in_j"] - energy["out_j"] - energy["stored_j"]) < 1e-6 * energy["in_j"]


def test_energy_in_is_the_heaters_power_times_time():
    chamber = Chamber(PARAMETERS, QUIET, 0)
    chamber.step(600.0, 0.5, False, 0.0, False)
    # 100 W * 0.97 (supply) * 0.5 * 600 s
    assert chamber.energy()["heater_in_j"] == pytest.approx(29100.0, rel=1e-9)


def test_nothing_drifts_at_the_rooms_temperature():
    chamber = Chamber(PARAMETERS, dataclasses.replace(QUIET, evapotranspiration=0.0), 0)
    chamber.step(3600.0, 0.0, False, 0.0, False)
    temps = [value for key, value in chamber.truth().items() if key.startswith("temp_")]
    assert max(abs(value - ROOM_C) for value in temps) < 1e-9


def test_without_effects_it_is_the_papers_balance():
    # dT/dt = H / (rho V c) - F (T - T_amb) / V: 240 s of 60 W, then the fan for 20 s
    chamber = Chamber(PARAMETERS, Effects.none(), 0)
    chamber.step(240.0, 0.6, False, 0.0, False)
    capacity = 1.2 * 1005.0 * 0.15
    rise = 60.0 * 240.0 / capacity
    assert chamber.truth()["temp_air_c"] - ROOM_C == pytest.approx(rise, rel=1e-4)
    chamber.step(20.0, 0.0, True, 0.0, False)
    left = rise * math.exp(-20.0 * PARAMETERS.fan.flow_m3_s / 0.15)
    assert chamber.truth()["temp_air_c"] - ROOM_C == pytest.approx(left, abs=0.01 * rise)


def test_the_walls_alone_lose_by_their_resistances_in_series():
    effects = Effects.none(wall_loss=1.0, heater_lag=1.0)
    chamber = Chamber(PARAMETERS, effects, 0)
    chamber.step(3 * 3600.0, 1.0, False, 0.0, False)
    cover, soil = PARAMETERS.cover, PARAMETERS.soil
    resistance = 1.0 / cover.inner_film_w_m2_k + 1.0 / cover.gap_w_m2_k + 1.0 / cover.outer_film_w_m2_k
    loss_w_k = 1.45 / resistance + 1.0 / (1.0 / soil.air_w_k + 1.0 / soil.floor_w_k)  # 1.45 m2 of cover
    assert chamber.truth()["temp_air_c"] - ROOM_C == pytest.approx(100.0 / loss_w_k, rel=1e-4)


def test_a_warm_box_loses_heat_and_never_falls_below_the_room():
    chamber = warm_box(dataclasses.replace(QUIET, evapotranspiration=0.0))
    before = chamber.truth()["temp_air_c"]
    for _ in range(6):
        chamber.step(1800.0, 0.0, False, 0.0, False)
        after = chamber.truth()["temp_air_c"]
        assert ROOM_C - 1e-6 < after < before
        before = after


def test_the_fan_pulls_a_warm_box_close_to_the_room_within_minutes():
    chamber, left_alone = warm_box(), warm_box()
    warm = chamber.truth()["temp_air_lower_c"]
    chamber.step(180.0, 0.0, True, 0.0, False)
    left_alone.step(180.0, 0.0, False, 0.0, False)
    assert warm > ROOM_C + 12.0
    assert chamber.truth()["temp_air_lower_c"] < ROOM_C + 5.0
    assert chamber.truth()["temp_air_lower_c"] < left_alone.truth()["temp_air_lower_c"] - 4.0


def test_the_fan_warms_no_box_at_the_rooms_temperature_but_by_its_motor():
    effects = dataclasses.replace(QUIET, evapotranspiration=0.0)
    for motor, largest_k in ((0.0, 1e-9), (1.0, 0.2)):
        chamber = Chamber(PARAMETERS, dataclasses.replace(effects, fan_motor_heat=motor), 0)
        chamber.step(1800.0, 0.0, True, 0.0, False)
        assert 0.0 <= chamber.truth()["temp_air_c"] - ROOM_C + 1e-9 < largest_k + 2e-9


def test_a_relay_stuck_on_overheats_the_box_and_the_fan_holds_it():
    chamber = Chamber(PARAMETERS, QUIET, 0)
    chamber.step(2 * 3600.0, 1.0, False, 0.0, False)
    assert chamber.truth()["temp_air_lower_c"] > 40.0
    chamber.step(600.0, 1.0, True, 0.0, False)
    assert chamber.truth()["temp_air_lower_c"] < 30.0


def test_about_three_fifths_of_the_hot_elements_heat_is_radiation():
    truth = warm_box().truth()
    assert 0.5 < truth["radiated_w"] / truth["heater_w"] < 0.65
    assert 180.0 < truth["temp_heater_c"] < 260.0  # class: 100 W ceramic emitters


def test_warm_nodes_lie_in_the_order_of_the_heat_flow():
    t = warm_box().truth()
    order = ("heater", "air_upper", "air_lower", "cover_inner", "cover_outer", "ambient")
    temps = [t[f"temp_{name}_c"] for name in order]
    assert temps == sorted(temps, reverse=True)


def test_opening_the_fan_dries_a_humid_box():
    chamber = warm_box()
    chamber.step(3600.0, 0.3, False, 1.0, False)
    before = chamber.truth()["vapour_g_m3"]
    chamber.step(120.0, 0.3, True, 1.0, False)
    assert chamber.truth()["vapour_g_m3"] < 0.8 * before


def test_light_and_warmth_raise_evaporation_and_dry_the_soil():
    dark, lit = Chamber(PARAMETERS, QUIET, 0), Chamber(PARAMETERS, QUIET, 0)
    dark.step(7200.0, 0.0, False, 0.0, False)
    lit.step(7200.0, 0.3, False, 1.0, False)
    assert lit.truth()["soil_moisture"] < dark.truth()["soil_moisture"] < PARAMETERS.soil.water_start


def test_a_valve_pulse_moves_water_from_the_tank_to_the_soil():
    chamber = Chamber(PARAMETERS, dataclasses.replace(QUIET, evapotranspiration=0.0), 0)
    before = chamber.truth()
    chamber.step(10.0, 0.0, False, 0.0, True)
    after = chamber.truth()
    poured_kg = 10.0 * PARAMETERS.tank.valve_flow_kg_s
    assert (before["tank_level"] - after["tank_level"]) * PARAMETERS.tank.volume_kg == pytest.approx(
        poured_kg
    )
    gain = after["soil_moisture"] - before["soil_moisture"]
    assert gain * PARAMETERS.soil.water_capacity_kg == pytest.approx(poured_kg)
    chamber.step(3600.0, 0.0, False, 0.0, True)
    assert chamber.truth()["tank_level"] == 0.0


def test_water_is_conserved_in_a_closed_box():
    effects = dataclasses.replace(QUIET, infiltration=0.0)
    chamber = Chamber(changed(box__height_m=0.6), effects, 0)

    def water_g() -> float:
        t = chamber.truth()
        return (
            1000.0 * t["soil_moisture"] * PARAMETERS.soil.water_capacity_kg
            + 0.15 * t["vapour_g_m3"]
            + t["film_g"]
        )

    before = water_g()
    chamber.step(4 * 3600.0, 0.4, False, 1.0, False)
    assert chamber.truth()["film_g"] > 0.0
    assert water_g() == pytest.approx(before, abs=1e-6)


def test_light_takes_up_co2_and_the_fan_brings_the_rooms_back():
    chamber = Chamber(PARAMETERS, QUIET, 0)
    chamber.step(3600.0, 0.0, False, 1.0, False)
    room_ppm = PARAMETERS.room.co2_ppm
    assert chamber.truth()["co2_ppm"] < room_ppm - 20.0
    chamber.step(300.0, 0.0, True, 1.0, False)
    assert abs(chamber.truth()["co2_ppm"] - room_ppm) < 5.0


@pytest.mark.parametrize(
    "effects", [QUIET, dataclasses.replace(QUIET, heater_deadtime=1.0, fan_deadtime=1.0)]
)
def test_the_length_of_a_step_does_not_matter(monkeypatch, effects):
    def course(longest_s: float) -> list[float]:
        monkeypatch.setattr(chamber_module, "MAX_STEP_S", longest_s)
        chamber, temps = Chamber(PARAMETERS, effects, 0), []
        for second in range(3600):
            relay = float(second % 20 < 12) if second < 2400 else 0.0
            chamber.step(1.0, relay, second // 300 % 4 == 3, 0.0, False)
            temps.append(chamber.truth()["temp_air_lower_c"])
        return temps

    fine, coarse = course(0.1), course(1.0)
    assert max(abs(a - b) for a, b in zip(fine, coarse, strict=True)) < 0.02


def test_time_handed_in_finely_is_the_same_time():
    one, many = Chamber(PARAMETERS, DEFAULT_SET, 5), Chamber(PARAMETERS, DEFAULT_SET, 5)
    one.step(600.0, 1.0, False, 0.0, False)
    for _ in range(6000):
        many.step(0.1, 1.0, False, 0.0, False)
    assert many.truth()["temp_air_c"] == pytest.approx(one.truth()["temp_air_c"], abs=1e-6)


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    def run(seed: int) -> list[dict[str, float]]:
        chamber, rows = Chamber(PARAMETERS, DEFAULT_SET, seed), []
        for minute in range(20):
            chamber.step(60.0, 0.5, minute > 10, 0.0, False)
            rows.append(chamber.sense() | chamber.truth())
        return rows

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_a_copy_has_the_same_future_and_leaves_the_original_alone():
    every = Effects.from_mapping({name: 1.0 for name in EFFECT_NAMES})
    original = Chamber(PARAMETERS, every, 2)
    original.step(605.5, 0.5, True, 0.3, True)
    before = original.truth()
    twin = original.copy()
    twin.step(3600.0, 1.0, False, 0.0, False)
    assert original.truth() == before
    original.step(3600.0, 1.0, False, 0.0, False)
    assert (original.truth(), original.sense(), original.energy()) == (
        twin.truth(),
        twin.sense(),
        twin.energy(),
    )


def test_reading_the_sensors_changes_nothing():
    asked, unasked = Chamber(PARAMETERS, DEFAULT_SET, 4), Chamber(PARAMETERS, DEFAULT_SET, 4)
    for _ in range(100):
        asked.step(1.0, 1.0, False, 0.0, False)
        assert asked.sense() == asked.sense()
        unasked.step(1.0, 1.0, False, 0.0, False)
    assert asked.truth() == unasked.truth()


def test_temperatures_are_shown_in_steps_of_a_tenth():
    chamber = Chamber(PARAMETERS, DEFAULT_SET, 0)
    shown = set()
    for _ in range(60):
        chamber.step(10.0, 1.0, False, 0.0, False)
        for key in ("temp_air_c", "temp_ambient_c"):
            value = chamber.sense()[key]
            assert value * 10.0 == pytest.approx(round(value * 10.0), abs=1e-9)
            shown.add(value)
    assert len(shown) > 10


def test_the_sensor_lags_behind_rising_air():
    chamber = Chamber(PARAMETERS, QUIET, 0)
    chamber.step(120.0, 1.0, False, 0.0, False)
    first = chamber.truth()
    assert first["temp_air_lower_c"] > first["temp_sensor_c"] > ROOM_C
    chamber.step(60.0, 1.0, False, 0.0, False)
    slope = (chamber.truth()["temp_air_lower_c"] - first["temp_air_lower_c"]) / 60.0
    behind = chamber.truth()["temp_air_lower_c"] - chamber.truth()["temp_sensor_c"]
    assert behind == pytest.approx(
        slope * PARAMETERS.sensors.air_lag_s, rel=0.1
    )  # a ramp is followed tau late


def test_the_sensors_are_of_the_half_degree_class():
    errors = []
    for seed in range(20):
        chamber = Chamber(PARAMETERS, DEFAULT_SET, seed)
        for _ in range(20):
            chamber.step(60.0, 0.0, False, 0.0, False)
            errors.append(chamber.sense()["temp_air_c"] - chamber.truth()["temp_sensor_c"])
    mean = sum(errors) / len(errors)
    spread = math.sqrt(sum((error - mean) ** 2 for error in errors) / len(errors))
    assert mean == pytest.approx(PARAMETERS.sensors.air_bias_k, abs=0.02)
    assert 0.04 < spread < 0.1
    assert max(abs(error) for error in errors) < 0.75


def test_the_sensors_show_what_a_sensor_report_carries():
    assert set(Chamber(PARAMETERS, DEFAULT_SET, 0).sense()) == {
        "temp_air_c", "rel_humidity_pct", "co2_ppm", "light", "soil_moisture", "tank_level", "temp_ambient_c",
    }  # fmt: skip


@pytest.mark.parametrize("dt_s", [-1.0, -1e-9, math.nan, math.inf])
def test_a_wrong_length_of_time_is_refused(dt_s):
    with pytest.raises(ValueError, match="dt_s"):
        Chamber(PARAMETERS, DEFAULT_SET, 0).step(dt_s, 0.0, False, 0.0, False)


@pytest.mark.parametrize("fraction", [math.nan, -0.1, -math.inf, 0.0])
def test_a_power_that_is_none_heats_nothing(fraction):
    chamber = Chamber(PARAMETERS, DEFAULT_SET, 0)
    chamber.step(60.0, fraction, False, 0.0, False)
    assert chamber.energy()["heater_in_j"] == 0.0


def test_a_power_above_full_is_full():
    over, full = Chamber(PARAMETERS, DEFAULT_SET, 0), Chamber(PARAMETERS, DEFAULT_SET, 0)
    over.step(60.0, math.inf, False, 9.0, False)
    full.step(60.0, 1.0, False, 1.0, False)
    assert over.truth() == full.truth()


scales = st.fixed_dictionaries({}, optional={name: st.floats(0.0, LARGEST_SCALE) for name in EFFECT_NAMES})
any_float = st.floats(allow_nan=True, allow_infinity=True)
inputs = st.lists(
    st.tuples(st.sampled_from([0.05, 0.3, 1.0, 60.0]), any_float | st.floats(0.0, 1.0), st.booleans(),
              any_float | st.floats(0.0, 1.0), st.booleans()),
    max_size=12,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(scales=scales, inputs=inputs, seed=st.integers(0, 2**64))
def test_whatever_the_switches_and_inputs_every_value_is_finite_and_plausible(scales, inputs, seed):
    chamber = Chamber(PARAMETERS, Effects.from_mapping(scales), seed)
    for dt_s, heater, fan, led, valve in inputs:
        chamber.step(dt_s, heater, fan, led, valve)
        sensed, truth = chamber.sense(), chamber.truth()
        assert all(math.isfinite(value) for value in [*sensed.values(), *truth.values()])
        assert all(-20.0 < v < 900.0 for k, v in truth.items() if k.startswith("temp_"))
        assert 0.0 <= sensed["rel_humidity_pct"] <= 100.0
    energy = chamber.energy()
    moved = 1.0 + abs(energy["in_j"]) + abs(energy["out_j"])
    assert abs(energy["in_j"] - energy["out_j"] - energy["stored_j"]) < 1e-6 * moved


@settings(max_examples=15, deadline=None)
@example(dry=3.0, massless=True, led=1.0)  # swung by 40 K when a wet node kept only 20 J/K
@given(dry=st.floats(0.0, LARGEST_SCALE), massless=st.booleans(), led=st.floats(0.0, 1.0))
def test_strong_evaporation_does_not_make_a_light_node_swing(dry, massless, led):
    mass = 0.0 if massless else 1.0
    effects = dataclasses.replace(
        QUIET,
        evapotranspiration=dry,
        condensation=LARGEST_SCALE,
        plant_mass=mass,
        soil_mass=mass,
        wall_mass=mass,
    )
    chamber = Chamber(PARAMETERS, effects, 0)
    chamber.step(1800.0, 1.0, False, led, False)
    temps = []
    for _ in range(4):
        chamber.step(1.0, 1.0, False, led, False)
        t = chamber.truth()
        temps.append((t["temp_plant_c"], t["temp_soil_c"], t["temp_cover_inner_c"]))
    for before, after in itertools.pairwise(temps):
        assert max(abs(a - b) for a, b in zip(before, after, strict=True)) < 0.05
