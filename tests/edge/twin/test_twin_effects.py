import numpy as np
import pytest

from edge.core.errors import DataError
from edge.twin.effects.library import EFFECTS
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

STEPS = 30
MASS = {"C_w": 8000.0, "G_in": 10.0, "G_out": 10.0}  # 1/UA = 1/10 + 1/10
CONDITIONS = {"light": 0.5, "solar": 300.0, "rel_humidity": 60.0, "utc": 3.0 * 86400.0, "door_open": 0.0}
WRONG = {"nan": np.nan, "inf": np.inf, "below": -1e15, "above": 1e15}


def run(effects, duty, fan, temp=21.0, steps=STEPS, fan_control="relay", **conditions):
    """Free run at a room of 21 °C from rest; duty and fan constant or per step."""
    twin = BoxTwin(effects=effects, day0_utc=0.0, fan_control=fan_control)
    inputs = (np.broadcast_to(np.asarray(item, dtype=float), (1, steps)) for item in (duty, fan))
    columns = {name: np.broadcast_to(column, steps) for name, column in {**CONDITIONS, **conditions}.items()}
    return twin.rollout(at_rest(twin, temp, 21.0), *inputs, 21.0, conditions=columns)[0]


def test_a_leaky_wall_lets_a_warm_box_cool_and_a_cold_one_warm():
    loss = {"wall_loss": {"UA": 5.0}}
    # time constant rho c V / UA
    left = np.exp(-60.0 * 5.0 / (1.2 * 1005.0 * 0.15))
    assert run(loss, 0.0, 0.0, temp=31.0)[0] == pytest.approx(21.0 + 10.0 * left)
    assert run(loss, 0.0, 0.0, temp=11.0)[0] == pytest.approx(21.0 - 10.0 * left)


def test_no_loss_is_no_effect():
    np.testing.assert_array_equal(run({"wall_loss": {"UA": 0.0}}, 0.01, 0.0), run({}, 0.01, 0.0))


def test_capacity_slows_what_the_heater_does_and_scales_it():
    # with the fan off, nothing lost: dT = H t / (kC rho c V)
    rise = run({"extra_capacity": {"kC": 4.0}}, 0.01, 0.0) - 21.0
    np.testing.assert_allclose(rise, (run({}, 0.01, 0.0) - 21.0) / 4.0)


def test_an_efficient_heater_is_a_smaller_duty():
    np.testing.assert_allclose(run({"heater_efficiency": {"eta": 0.5}}, 0.4, 1.0), run({}, 0.2, 1.0))


def test_a_weak_fan_is_a_slow_fan():
    weak, slow = run({"fan_effectiveness": {"eps_f": 0.5}}, 0.4, 1.0), run({}, 0.4, 0.5, fan_control="speed")
    np.testing.assert_allclose(weak, slow, atol=1e-9)
    assert run({}, 0.4, 0.5)[0] > weak[0] + 3.0  # of a relay that is off in half of the step: heated since


def test_a_slow_heater_is_late_and_gives_all_its_heat_in_the_end():
    lag, pulse = {"heater_lag": {"tau_h": 120.0}}, [0.1] * 5 + [0.0] * (STEPS - 5)
    late, at_once = run(lag, pulse, 0.0), run({}, pulse, 0.0)
    assert late[0] < at_once[0] - 0.5
    assert np.all(np.diff(late[4:]) > 0.0)  # it goes on after the heater is off
    # what is left in the element after 25 minutes: exp(-1500 / 120) of 16.6 K
    assert late[-1] == pytest.approx(at_once[-1], abs=1e-4)


def test_a_heavy_wall_ends_where_a_light_one_does_but_later():
    heavy, light = run({"wall_mass": MASS}, 0.2, 0.0, steps=300), run({"wall_loss": {"UA": 5.0}}, 0.2, 0.0)
    assert heavy[9] < light[9] - 1.0
    assert heavy[-1] == pytest.approx(light[-1], abs=0.01)


def test_a_heavy_wall_warms_the_box_after_the_fan():
    fan = [1.0] * 5 + [0.0] * 5
    twin = BoxTwin(effects={"wall_mass": MASS})
    temps = twin.rollout(at_rest(twin, 35.0, 21.0), np.zeros((1, 10)), np.array([fan]), 21.0)[0]
    assert temps[5] > temps[4] + 0.5


def test_a_wall_with_mass_replaces_the_wall_without():
    both = {"wall_loss": {"UA": 50.0}, "wall_mass": MASS}
    np.testing.assert_array_equal(run(both, 0.2, 0.0), run({"wall_mass": MASS}, 0.2, 0.0))


def test_a_leak_stops_while_the_fan_runs():
    leak, pulse = {"infiltration": {"F_inf": 0.003}}, [0.3] + [0.0] * (STEPS - 1)
    assert run(leak, pulse, 0.0)[-1] < run({}, pulse, 0.0)[-1] - 5.0
    np.testing.assert_allclose(run(leak, pulse, 1.0), run({}, pulse, 1.0))


def test_air_that_leaves_unmixed_is_a_slow_fan():
    slow = run({}, 0.4, 0.6, fan_control="speed")
    np.testing.assert_allclose(run({"short_circuit": {"s_sc": 0.4}}, 0.4, 1.0), slow, atol=1e-9)


def test_soil_takes_heat_and_gives_it_all_back():
    soil, loss = {"soil_mass": {"C_s": 9000.0, "G_s": 4.0}}, {"wall_loss": {"UA": 5.0}}
    heavy, light = run(soil | loss, 0.2, 0.0, steps=600), run(loss, 0.2, 0.0, steps=600)
    assert heavy[9] < light[9] - 0.5
    assert heavy[-1] == pytest.approx(light[-1], abs=1e-3)  # 21 + 20 W / 5 W/K: soil passes no heat


def test_radiant_heat_is_lost_unless_a_node_takes_it():
    split = {"radiative_split": {"f_rad": 0.4}}
    np.testing.assert_allclose(run(split, 0.5, 1.0), run({}, 0.3, 1.0))
    with_soil = run(split | {"soil_mass": {"C_s": 9000.0, "G_s": 4.0}}, 0.5, 1.0, steps=600)
    assert with_soil[-1] == pytest.approx(run({}, 0.5, 1.0)[-1], abs=1e-3)  # in the end the air has it all


def test_a_saturated_heater_is_a_smaller_duty_and_a_sagging_one_by_the_square():
    np.testing.assert_allclose(run({"heater_saturation": {"u_sat": 0.3}}, 0.8, 1.0), run({}, 0.3, 1.0))
    np.testing.assert_allclose(run({"heater_saturation": {"u_sat": 0.3}}, 0.2, 1.0), run({}, 0.2, 1.0))
    np.testing.assert_allclose(
        run({"heater_sag": {"sag": 0.25}}, 0.8, 1.0), run({}, 0.64, 1.0)
    )  # .8 (1 - .2)


def test_a_dead_time_of_whole_steps_is_the_same_later():
    pulse = np.array([0.0, 0.3, 0.1] + [0.0] * (STEPS - 3))
    np.testing.assert_allclose(
        run({"heater_deadtime": {"d_h": 120.0}}, pulse, 0.0)[2:], run({}, pulse, 0.0)[:-2]
    )
    fan = (np.arange(STEPS) % 5 == 2) * 1.0
    late = run({"fan_deadtime": {"d_f": 60.0}}, 0.1, fan)
    np.testing.assert_allclose(late, run({}, 0.1, np.append(0.0, fan[:-1])), atol=1e-9)


def test_the_first_part_of_a_late_pulse_is_missing():
    # 60 s less 45 s of 10 W into 180.9 J/K
    risen = run({"heater_deadtime": {"d_h": 45.0}}, [0.1] + [0.0] * (STEPS - 1), 0.0) - 21.0
    assert risen[0] == pytest.approx(10.0 * 15.0 / (1.2 * 1005.0 * 0.15))
    assert risen[1] == pytest.approx(10.0 * 60.0 / (1.2 * 1005.0 * 0.15))


def test_a_fan_that_spins_up_cools_late():
    late, at_once = run({"fan_spinup": {"tau_f": 60.0}}, 0.4, 1.0), run({}, 0.4, 1.0)
    assert late[0] > at_once[0] + 1.0
    assert late[-1] == pytest.approx(at_once[-1], abs=1e-3)


def test_heat_reaches_the_other_half_of_the_air_late():
    mixing, pulse = {"imperfect_mixing": {"F_mix": 0.002}}, [0.1] + [0.0] * (STEPS - 1)
    apart, whole = run(mixing, pulse, 0.0), run({}, pulse, 0.0)
    assert apart[0] < whole[0] - 0.5
    assert apart[-1] == pytest.approx(whole[-1], abs=1e-3)  # no heat is lost on the way
    assert run(mixing, 0.4, 1.0)[-1] == pytest.approx(
        run({}, 0.4, 1.0)[-1], abs=1e-3
    )  # all leaves by the fan


def test_a_slow_sensor_is_behind_and_arrives():
    rise = 1.0 - np.exp(-60.0 / 120.0)  # of a step in the air, a minute after it
    twin = BoxTwin(effects={"sensor_lag": {"tau_s": 120.0}})
    temps = twin.rollout(np.array([21.0, 31.0]), np.zeros((1, 60)), np.zeros((1, 60)), 21.0)[0]
    assert temps[0] == pytest.approx(21.0 + 10.0 * rise)
    assert temps[-1] == pytest.approx(31.0, abs=1e-6)


def test_a_wrong_room_and_a_wrong_sensor_shift_where_the_box_settles():
    loss = {"wall_loss": {"UA": 5.0}}
    assert run({**loss, "sensor_bias": {"bias": 0.5}}, 0.0, 0.0, steps=200)[-1] == pytest.approx(21.5)
    assert run({**loss, "ambient_offset": {"b_amb": 0.5}}, 0.0, 0.0, steps=200)[-1] == pytest.approx(20.5)


def test_other_heat_is_a_duty():
    np.testing.assert_allclose(run({"constant_heat": {"P0": 10.0}}, 0.3, 1.0), run({}, 0.4, 1.0))
    np.testing.assert_allclose(run({"led_gain": {"P_led": 20.0}}, 0.3, 1.0, light=0.5), run({}, 0.4, 1.0))


def test_a_fans_motor_heats_while_it_runs():
    np.testing.assert_allclose(run({"fan_heat": {"P_fan": 10.0}}, 0.3, 1.0), run({}, 0.4, 1.0))
    np.testing.assert_allclose(run({"fan_heat": {"P_fan": 10.0}}, 0.01, 0.0), run({}, 0.01, 0.0))


def test_the_ground_draws_the_box_to_its_own_temperature():
    ground = {"ground_loss": {"G_g": 5.0, "T_g": 14.0}, "wall_loss": {"UA": 5.0}}
    assert run(ground, 0.0, 0.0, steps=100)[-1] == pytest.approx(0.5 * (14.0 + 21.0), abs=1e-6)


@pytest.mark.parametrize("name", ["stack_ventilation", "natural_convection"])
def test_a_loss_that_grows_with_the_difference_is_a_walls_at_10_k(name):
    # at 10 K the same conductance; above it the warm box settles lower, below it higher
    values = {"stack_ventilation": {"F_st": 4.0 / 1206.0}, "natural_convection": {"G_nc": 4.0}}[name]
    bent, wall = ({name: values}, {"wall_loss": {"UA": 4.0}})
    ends = {
        duty: [run(effects, duty, 0.0, steps=60)[-1] for effects in (bent, wall)] for duty in (0.2, 0.4, 0.6)
    }
    assert ends[0.4][0] == pytest.approx(31.0, abs=1e-3) == ends[0.4][1]
    assert ends[0.2][0] > ends[0.2][1] + 0.3
    assert ends[0.6][0] < ends[0.6][1] - 0.3


def test_a_heater_that_fades_holds_a_box_where_its_power_and_the_loss_meet():
    fading = {"wall_loss": {"UA": 4.0}, "heater_derating": {"k_P": 0.01}}
    # 40 W (1 - 0.01 (T - 20)) = 4 W/K (T - 21)
    assert run(fading, 0.4, 0.0, steps=100)[-1] == pytest.approx(30.0, abs=1e-3)
    assert run(fading, 0.0, 0.0, steps=100)[-1] == pytest.approx(21.0, abs=1e-3)


def test_dry_and_bright_air_is_cooled_and_saturated_air_is_not():
    effects = {"evapotranspiration": {"k_e": 20.0}}
    ends = [
        run(effects, 0.3, 1.0, light=light, rel_humidity=humidity)[-1]
        for light, humidity in ((0.0, 100.0), (0.0, 50.0), (1.0, 50.0))
    ]
    assert ends[0] == pytest.approx(run({}, 0.3, 1.0)[-1])
    assert ends[0] > ends[1] + 0.3 > ends[2] + 0.6


def test_life_warms_the_box_twice_as_much_for_each_10_k():
    # 4.5 W at 20 °C are 9 W at 30 °C, which is what 1 W/K loses over a room of 21 °C
    life = {"respiration_heat": {"P_res": 4.5}, "wall_loss": {"UA": 1.0}}
    assert run(life, 0.0, 0.0, steps=200)[-1] == pytest.approx(30.0, abs=1e-3)
    # 20 W at 20 °C are 80 W at 40 °C and above, which is what 2 W/K loses at 61 °C
    hot = {"respiration_heat": {"P_res": 20.0}, "wall_loss": {"UA": 2.0}}
    assert run(hot, 0.0, 0.0, temp=45.0, steps=100)[-1] == pytest.approx(61.0, abs=1e-3)


def test_a_stirring_fan_loses_as_much_as_it_says():
    # 0.3 x 100 W over 2 W/K are 15 K over a room of 21 °C, and over 2 + 3 W/K they are 6 K
    stirred = {"stirred_loss": {"G_stir": 3.0}, "wall_loss": {"UA": 2.0}, "fan_effectiveness": {"eps_f": 0.0}}
    assert run(stirred, 0.3, 0.0, steps=200)[-1] == pytest.approx(36.0, abs=1e-3)
    assert run(stirred, 0.3, 1.0, steps=200)[-1] == pytest.approx(27.0, abs=1e-3)


def test_a_blown_element_gives_its_heat_sooner_but_no_more():
    lag = {
        "wall_loss": {"UA": 2.0},
        "fan_effectiveness": {"eps_f": 0.0},
        "heater_lag": {"tau_h": 300.0},
    }
    blown = {**lag, "blown_element": {"k_el": 1.0}}
    half = {**lag, "heater_lag": {"tau_h": 150.0}}  # twice as fast is half the lag
    assert run(blown, 0.3, 0.0, steps=30) == pytest.approx(run(lag, 0.3, 0.0, steps=30))
    assert run(blown, 0.3, 1.0, steps=30) == pytest.approx(run(half, 0.3, 1.0, steps=30))
    assert run(blown, 0.3, 1.0, steps=200)[-1] == pytest.approx(36.0, abs=1e-3)


def test_radiation_is_a_little_more_than_a_wall_in_a_warm_box():
    # 4 sigma T^3 at 25 °C is 6.01 W/(m² K) and at 33 °C, between room and box, 8 % more; by UA t / C = 2.0
    # the 24 K have become 3.3 K, and 8 % of 2.0 takes off a further 16 % of them at the most
    warm = [
        run(effects, 0.0, 0.0, temp=45.0)[0]
        for effects in ({"wall_loss": {"UA": 6.01}}, {"longwave_radiation": {"epsA": 1.0}})
    ]
    assert 0.05 < warm[0] - warm[1] < 0.5


def test_an_open_door_cools_for_its_share_of_a_step_alone():
    door, warm = {"door_opening": {"G_door": 20.0}}, np.arange(STEPS) == 3
    temps = run(door, 0.0, 0.0, temp=31.0, door_open=0.5 * warm)
    np.testing.assert_allclose(temps[:3], 31.0)
    # half of 20 W/K for 60 s on 180.9 J/K
    np.testing.assert_allclose(temps[3:], 21.0 + 10.0 * np.exp(-10.0 * 60.0 / (1.2 * 1005.0 * 0.15)))


def test_walls_that_tighten_end_at_no_loss():
    tight = run({"wall_loss": {"UA": 5.0}, "ua_drift": {"ua_drift": -0.05}}, 0.1, 0.0, utc=50.0 * 86400.0)
    np.testing.assert_allclose(tight, run({}, 0.1, 0.0))


def test_walls_age_by_the_day():
    aged = run({"wall_loss": {"UA": 5.0}, "ua_drift": {"ua_drift": 0.1}}, 0.1, 0.0, utc=3.0 * 86400.0)
    np.testing.assert_allclose(aged, run({"wall_loss": {"UA": 6.5}}, 0.1, 0.0))


@pytest.mark.parametrize("name", [name for name, effect in EFFECTS.items() if effect.needs])
def test_a_missing_column_is_named(name):
    values = {item.name: item.start for item in EFFECTS[name].parameters}
    column = EFFECTS[name].needs[-1]
    given = {key: np.full(2, 0.5) for key in EFFECTS[name].needs if key != column}
    with pytest.raises(DataError, match=rf"^{column}: missing, the twin's {name} needs this column$"):
        BoxTwin(effects={name: values}).rollout(
            np.array([22.0]), *np.zeros((2, 1, 2)), 21.0, conditions=given
        )


def test_days_need_a_beginning():
    twin = BoxTwin(effects={"ua_drift": {"ua_drift": 0.1}})
    with pytest.raises(DataError, match=r"^day0_utc: missing"):
        twin.rollout(np.array([22.0]), *np.zeros((2, 1, 2)), 21.0, conditions={"utc": np.zeros(2)})


def test_effects_compose_in_any_order():
    effects = {name: {item.name: item.start for item in EFFECTS[name].parameters} for name in EFFECTS}
    backwards = dict(reversed(effects.items()))
    fan = np.arange(STEPS) % 2
    np.testing.assert_allclose(run(effects, 0.3, fan), run(backwards, 0.3, fan))


@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_says_what_it_is(name):
    effect = EFFECTS[name]
    assert effect.add.__name__ == name
    assert effect.add.__doc__ and effect.source and effect.without
    for item in effect.parameters:
        assert item.low < item.start < item.high
        assert item.name in effect.add.__doc__


@pytest.mark.parametrize("value", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("name", EFFECTS)
def test_a_parameter_that_can_not_be_is_refused_with_its_place(name, value):
    first = EFFECTS[name].parameters[0]
    values = {item.name: item.start for item in EFFECTS[name].parameters} | {first.name: value}
    with pytest.raises(DataError, match=rf"^effects\.{name}\.{first.name}: "):
        BoxTwin(effects={name: values})


def test_bounds_themselves_are_allowed():
    for name, effect in EFFECTS.items():
        for item in effect.parameters:
            for edge in (item.low, item.high):
                values = {other.name: other.start for other in effect.parameters} | {item.name: edge}
                assert np.isfinite(run({name: values}, 0.5, 1.0)).all()


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"wall_los": {"UA": 5.0}}, "effects: unknown effect 'wall_los'; did you mean 'wall_loss'?"),
        ({"wall_loss": {"UB": 5.0}}, "effects.wall_loss: unknown parameter 'UB'; known keys: UA"),
        ({"wall_mass": {"C_w": 5e3, "G_in": 9.0}}, "effects.wall_mass.G_out: missing"),
    ],
)
def test_a_misspelt_effect_is_refused(effects, message):
    with pytest.raises(DataError) as caught:
        BoxTwin(effects=effects)
    assert str(caught.value) == message
