import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rk45 import rk45_rollout

from edge.core.errors import DataError
from edge.twin.discretisation import exponential
from edge.twin.geometry import Geometry
from edge.twin.model import FAN_CONTROLS, BoxTwin, StateNoise
from edge.twin.warm_start import at_rest

AIR_J_K = 1.2 * 1005.0 * 0.15  # rho c V of the paper's box
LOSS = {"wall_loss": {"UA": 5.0}}
EVERY_EFFECT = {
    "wall_mass": {"C_w": 5000.0, "G_in": 12.0, "G_out": 7.0},
    "extra_capacity": {"kC": 4.0},
    "heater_lag": {"tau_h": 300.0},
    "heater_efficiency": {"eta": 0.9},
    "fan_effectiveness": {"eps_f": 0.7},
}
TWINS = {"bare": {}, "loss": LOSS, "every effect": EVERY_EFFECT}
temps = st.floats(-10.0, 60.0)


def sequence(steps, seed, heat=1.0):
    """Duty, fan and ambient that switch as on the rig; `heat` scales the duty while the fan is off."""
    rng = np.random.default_rng(seed)
    fan = (rng.uniform(size=steps) < 0.4).astype(float)
    duty = rng.integers(0, 21, steps) / 20.0 * np.where(fan > 0.0, 1.0, heat)
    return duty, fan, 21.0 + rng.normal(size=steps)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
def test_a_whole_sequence_agrees_with_rk45_at_tight_tolerances(effects):
    twin = BoxTwin(effects=effects)
    start = at_rest(twin, 23.0, 21.0)
    duty, fan, ambient = sequence(60, seed=1, heat=0.3 if effects else 0.02)
    exact = twin.rollout(start, duty[None], fan[None], ambient)[0]
    reference = rk45_rollout(twin, start, duty, fan, ambient, rtol=1e-10, atol=1e-10)[:, 0]
    np.testing.assert_allclose(exact, reference, rtol=0, atol=1e-6)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
def test_a_source_over_the_step_agrees_with_rk45(effects):
    twin = BoxTwin(effects=effects)
    start = at_rest(twin, 23.0, 21.0)
    duty, fan, ambient = np.full(5, 0.1), np.array([0.0, 1.0, 1.0, 0.0, 0.0]), np.full(5, 21.0)
    exact = twin.rollout(start, duty[None], fan[None], ambient, source=-0.003)[0]
    reference = rk45_rollout(twin, start, duty, fan, ambient, source=-0.003, rtol=1e-10, atol=1e-10)[:, 0]
    np.testing.assert_allclose(exact, reference, rtol=0, atol=1e-6)


def test_without_fan_the_bare_box_keeps_every_joule():
    # eq. pbm with F = 0: 60 s * 5 W / 180.9 J/K
    assert BoxTwin().step(22.0, 15.0, 0.05, 0.0) == pytest.approx(22.0 + 300.0 / AIR_J_K, abs=1e-12)


def test_with_the_fan_alone_the_excess_decays_by_the_air_changes():
    # eq. pbm with H = 0: exp(-F t / V)
    excess = 10.0 * np.exp(-68.0 / 3600.0 * 60.0 / 0.15)
    assert BoxTwin().step(31.0, 21.0, 0.0, 1.0) == pytest.approx(21.0 + excess, abs=1e-12)


@pytest.mark.parametrize("control", FAN_CONTROLS)
def test_a_shorter_and_a_slower_fan_end_at_no_fan(control):
    twin = BoxTwin(fan_control=control)
    still = twin.step(30.0, 20.0, 0.02, 0.0)
    slow = [abs(float(twin.step(30.0, 20.0, 0.02, fan)) - still) for fan in (1e-4, 1e-8, 1e-12, 1e-300)]
    # to first order F t / V of the excess of 10 K is carried off
    assert slow[0] == pytest.approx(1e-4 * 68.0 / 3600.0 * 60.0 / 0.15 * 10.0, rel=0.1)
    assert slow[1] < 1e-5 and slow[2] < 1e-9 and slow[3] == 0.0


@given(temps, temps)
def test_a_box_without_heat_goes_towards_the_room_and_not_beyond(temp, ambient):
    after = float(BoxTwin(effects=LOSS).step(temp, ambient, 0.0, 0.0))
    assert min(temp, ambient) - 1e-9 <= after <= max(temp, ambient) + 1e-9
    if abs(temp - ambient) > 1e-6:
        assert abs(after - ambient) < abs(temp - ambient)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
@pytest.mark.parametrize("fan", [0.0, 0.5, 1.0])
def test_nothing_flows_between_equal_temperatures(effects, fan):
    twin = BoxTwin(effects=effects)
    state = at_rest(twin, 21.0, 21.0)
    np.testing.assert_allclose(twin.advance(state, 21.0, 0.0, fan), state, atol=1e-9)


def test_heat_put_in_is_stored_or_lost():
    """Trapezoid over steps of 1 s: C_a kC dT + C_w dT_w = eta H t - sum of G_out (T_w - T_amb)."""
    effects = {name: EVERY_EFFECT[name] for name in ("wall_mass", "extra_capacity", "heater_efficiency")}
    twin = BoxTwin(effects=effects, step_s=1.0)
    states = [np.array([22.0, 21.5])]
    for _ in range(600):
        states.append(twin.advance(states[-1], 21.0, 0.6, 0.0))
    air, wall = np.array(states).T
    stored = 4.0 * AIR_J_K * (air[-1] - air[0]) + 5000.0 * (wall[-1] - wall[0])
    lost = 7.0 * np.trapezoid(wall - 21.0)
    assert stored + lost == pytest.approx(0.9 * 60.0 * 600.0, rel=1e-6)


def test_at_rest_the_walls_pass_what_the_heater_gives():
    # 1/UA = 1/12 + 1/7; eta 0.9 of 50 W
    duty, resistance = 0.5, 1.0 / 12.0 + 1.0 / 7.0
    twin = BoxTwin(effects=EVERY_EFFECT)
    end = twin.rollout(at_rest(twin, 21.0, 21.0), np.full((1, 400), duty), np.zeros((1, 400)), 21.0)[0, -1]
    assert end == pytest.approx(21.0 + 0.9 * 50.0 * resistance, abs=1e-6)


def test_the_state_at_rest_stays_with_the_heat_that_holds_it():
    twin = BoxTwin(effects=EVERY_EFFECT)
    state = at_rest(twin, 29.0, 21.0)
    power = 8.0 / (1.0 / 12.0 + 1.0 / 7.0)
    assert state[2] == pytest.approx(power)
    np.testing.assert_allclose(twin.advance(state, 21.0, power / 90.0, 0.0), state, atol=1e-9)


@pytest.mark.parametrize("effects", TWINS.values(), ids=TWINS)
@pytest.mark.parametrize("speeds", [(0.0, 1.0), (0.0, 0.25, 1.0)])
def test_a_batch_is_its_rows_and_a_rollout_its_steps(effects, speeds):
    twin, rng = BoxTwin(effects=effects), np.random.default_rng(2)
    duty, fan = rng.uniform(size=(4, 7)), rng.choice(speeds, size=(4, 7))
    ambient, source = rng.uniform(18.0, 24.0, size=(4, 7)), rng.normal(0.0, 1e-3, size=(4, 7))
    start = np.stack([at_rest(twin, temp, 21.0) for temp in (21.0, 25.0, 30.0, 35.0)])
    together = twin.rollout(start, duty, fan, ambient, source)
    for b in range(4):
        state = start[b]
        for k in range(7):
            state = twin.advance(state, ambient[b, k], duty[b, k], fan[b, k], source[b, k])
            assert together[b, k] == pytest.approx(state[0], abs=1e-9)


def test_one_ambient_for_all_is_the_same_as_one_each():
    twin, (duty, fan, ambient) = BoxTwin(effects=LOSS), sequence(6, seed=3)
    both = np.stack([duty, duty[::-1]]), np.stack([fan, fan[::-1]])
    shared = twin.rollout(np.array([24.0]), *both, ambient)
    np.testing.assert_array_equal(shared, twin.rollout(np.array([24.0]), *both, np.stack([ambient] * 2)))


def test_the_offset_is_added_after_each_step_and_carried_on():
    twin = BoxTwin()
    moved = twin.rollout(np.array([22.0]), np.zeros((1, 3)), np.zeros((1, 3)), 20.0, offset=np.full(3, 0.1))
    np.testing.assert_allclose(moved[0], [22.1, 22.2, 22.3])


def test_arrays_step_as_their_elements():
    temp, fan = np.array([[22.0, 25.0], [28.0, 31.0]]), np.array([[0.0, 1.0], [0.5, 0.0]])
    stepped = BoxTwin().step(temp, 20.0, 0.1, fan)
    for place in np.ndindex(2, 2):
        assert stepped[place] == pytest.approx(BoxTwin().step(temp[place], 20.0, 0.1, fan[place]), abs=1e-9)


@pytest.mark.parametrize("unknown", ["temp", "ambient", "duty", "fan", "source"])
def test_what_is_not_known_gives_no_number(unknown):
    inputs = {"temp": 22.0, "ambient": 20.0, "duty": 0.5, "fan": 1.0, "source": 0.0, unknown: np.nan}
    assert np.isnan(BoxTwin(effects=LOSS).step(**inputs))


@pytest.mark.parametrize("fan", [np.nan, np.inf])
def test_a_network_with_an_unknown_fan_gives_no_number(fan):
    twin = BoxTwin(effects=EVERY_EFFECT)
    with np.errstate(invalid="ignore", over="ignore"):
        assert np.isnan(twin.advance(at_rest(twin, 22.0, 21.0), 21.0, 0.0, fan)).all()


def test_a_twin_with_hidden_states_does_not_step_from_a_temperature_alone():
    with pytest.raises(DataError, match=r"twin: wall, heater can't be known from a temperature alone"):
        BoxTwin(effects=EVERY_EFFECT).step(22.0, 21.0, 0.0, 0.0)


@pytest.mark.parametrize("step_s", [0.0, -60.0, np.nan, np.inf])
def test_a_step_is_a_finite_time(step_s):
    with pytest.raises(DataError, match=r"^sample_s: "):
        BoxTwin(step_s=step_s)


@pytest.mark.parametrize("value", [0.0, -0.15, np.nan, np.inf])
def test_a_geometry_is_finite_and_above_zero(value):
    with pytest.raises(DataError, match=r"^geometry\.volume_m3: "):
        Geometry(volume_m3=value)


def test_the_hash_is_of_what_a_prediction_depends_on():
    twin = BoxTwin(effects=LOSS)
    others = [
        BoxTwin(),
        BoxTwin(effects={"wall_loss": {"UA": 5.000001}}),
        BoxTwin(effects=LOSS, step_s=30.0),
        BoxTwin(Geometry(volume_m3=0.16), LOSS),
        BoxTwin(effects=LOSS, noise=StateNoise(heat_w=6.0)),
        BoxTwin(effects=LOSS, fan_control="speed"),
    ]
    assert len({twin.sha256, *(other.sha256 for other in others)}) == 7
    two = {**LOSS, "heater_lag": {"tau_h": 300}}
    assert BoxTwin(effects=two).sha256 == BoxTwin(effects=dict(reversed(two.items()))).sha256


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(-4, 3))
def test_the_matrix_exponential_is_scipys(seed, magnitude):
    from scipy.linalg import expm

    rates = np.random.default_rng(seed).normal(size=(1, 3, 3)) * 10.0**magnitude
    rates -= 4.0 * 10.0**magnitude * np.eye(3)  # it decays, as heat does
    exact, integral = exponential(rates, 2.0)
    np.testing.assert_allclose(exact[0], expm(2.0 * rates[0]), atol=1e-10)
    # A times the integral of exp(A s) is exp(A t) - 1
    np.testing.assert_allclose(rates[0] @ integral[0], exact[0] - np.eye(3), atol=1e-9)


def test_a_matrix_exponential_takes_a_time_for_each_matrix():
    rates = -np.random.default_rng(2).random((3, 2, 2))
    lengths = np.array([0.5, 2.0, 60.0])
    together = exponential(rates, lengths[:, None, None])
    for i, length in enumerate(lengths):
        alone = exponential(rates[i : i + 1], length)
        np.testing.assert_allclose([part[i] for part in together], [part[0] for part in alone], rtol=1e-9)
