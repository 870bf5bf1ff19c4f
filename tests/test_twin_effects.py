import numpy as np
import pytest

from edge.errors import DataError
from edge.twin.effects import EFFECTS
from edge.twin.model import Twin
from edge.twin.warm_start import at_rest

STEPS = 30
MASS = {"C_w": 8000.0, "G_in": 10.0, "G_out": 10.0}  # 1/UA = 1/10 + 1/10
CONDITIONS = {"light": 0.5, "rel_humidity": 60.0, "utc": 3.0 * 86400.0, "door_open": 0.0}
WRONG = {"nan": np.nan, "inf": np.inf, "below": -1e9, "above": 1e9}


def run(effects, duty, fan, temp=21.0, steps=STEPS, **conditions):
    """Free run at a room of 21 °C from rest; duty and fan constant or per step."""
    twin = Twin(effects=effects, day0_utc=0.0)
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
    np.testing.assert_allclose(
        run({"fan_effectiveness": {"eps_f": 0.5}}, 0.4, 1.0), run({}, 0.4, 0.5), atol=1e-9
    )


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
    twin = Twin(effects={"wall_mass": MASS})
    temps = twin.rollout(at_rest(twin, 35.0, 21.0), np.zeros((1, 10)), np.array([fan]), 21.0)[0]
    assert temps[5] > temps[4] + 0.5


def test_a_wall_with_mass_replaces_the_wall_without():
    both = {"wall_loss": {"UA": 50.0}, "wall_mass": MASS}
    np.testing.assert_array_equal(run(both, 0.2, 0.0), run({"wall_mass": MASS}, 0.2, 0.0))


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
        Twin(effects={name: values})


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
        Twin(effects=effects)
    assert str(caught.value) == message
