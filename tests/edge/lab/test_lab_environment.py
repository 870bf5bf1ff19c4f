"""edge/lab/environment.py: Gymnasium's own checker, the twin's rollout, seeds, the cost."""

import math
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from edge.core.errors import DataError
from edge.lab.box import PACKAGED_TWIN, conditions_at, full_rise_k
from edge.lab.cost import step_cost
from edge.lab.environment import AHEAD_STEPS, OBSERVATION, GreenhouseEnv
from edge.lab.episodes import EpisodeSettings, draw_light
from edge.models.policy_actions import ACTIONS, LEVELS, duties_and_fans
from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import at_rest

ROOT = Path(__file__).parents[3]
LATE = ROOT / "docs" / "examples" / "diagnosis" / "twin.yaml"  # with dead times
NAMES = [row.name for row in OBSERVATION]
# Late commands, a fan that spins up, heat that bends, lamp, humidity and age: every way a step is not plain.
ODD = """
day0_utc: 2026-01-01T00:00:00Z
effects:
  wall_mass: {C_w: 20000.0, G_in: 7.0, G_out: 12.0}
  heater_lag: {tau_h: 300.0}
  heater_deadtime: {d_h: 70.0}
  fan_deadtime: {d_f: 20.0}
  fan_spinup: {tau_f: 40.0}
  natural_convection: {G_nc: 3.0}
  led_gain: {P_led: 10.0}
  evapotranspiration: {k_e: 10.0}
  ua_drift: {ua_drift: 0.01}
"""


def env(**more):
    return gymnasium.make("edge.lab.environment:Greenhouse-v0", **more).unwrapped


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    path = tmp_path / "odd.yaml"
    path.write_text(ODD)
    return path


@pytest.mark.parametrize("more", [{}, {"continuous": True}, {"uncertain": True}, {"twin": LATE}])
def test_gymnasium_has_nothing_to_complain_of(more):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env(**more))


@pytest.mark.parametrize("which", ["packaged", "late", "odd"])
def test_an_episode_is_the_twins_own_rollout(which, odd):
    path = {"packaged": PACKAGED_TWIN, "late": LATE, "odd": odd}[which]
    steps, rng = 90, np.random.default_rng(3)
    ambient, light = 21.0 + rng.normal(size=steps), rng.random(steps).round()
    own = env(twin=path, steps=steps, ambient_c=ambient, light=light)
    _, info = own.reset(seed=1)
    start, actions = info["temp_air_c"], rng.integers(ACTIONS, size=steps)
    played = np.array([own.step(action)[4]["temp_air_c"] for action in actions])
    twin = read_twin_file(path).twin()
    duty, fan = duties_and_fans(actions[None])
    conditions = conditions_at(twin, np.arange(steps) * twin.step_s, light)
    rest = at_rest(twin, start, ambient[0])
    expected = twin.rollout(rest, duty, fan, ambient, conditions=conditions)[0]
    assert np.ptp(played) > 3.0
    assert np.abs(played - expected).max() < 1e-9


def test_a_seed_gives_an_episode_and_another_seed_another():
    def played(seed):
        own = env()
        first, _ = own.reset(seed=seed)
        return np.array([first, *(own.step(action)[0] for action in range(20))])

    assert np.array_equal(played(1), played(1))
    assert not np.array_equal(played(1), played(2))


def test_episodes_of_one_environment_differ():
    own = env()
    first, _ = own.reset(seed=1)
    second, _ = own.reset()
    assert not np.array_equal(first, second)


def test_the_reward_is_minus_the_papers_cost_by_the_true_air():
    own = env(reference=30.0, ambient_c=21.0)
    own.reset(seed=1)
    _, reward, _, _, info = own.step(LEVELS + 10)  # half of the heat, with the fan on
    error = info["temp_air_c"] - 30.0
    assert reward == -info["cost"] == -(10.0 * error**2 + 0.25 + 1.0)
    assert step_cost(2.0, 0.5, 1.0, effort_weight=0.0) == 40.0


def test_the_first_reference_is_for_the_end_of_the_step_that_begins():
    course = 24.0 + np.arange(50.0)
    own = env(steps=5, reference=course, ambient_c=21.0)
    seen, info = own.reset(seed=1)
    assert info["temp_air_c"] == course[0]
    for k in range(4):
        shown = [seen[NAMES.index(f"reference_{ahead}_c")] for ahead in AHEAD_STEPS]
        assert shown == [course[k + ahead] for ahead in AHEAD_STEPS]
        seen, reward, _, _, info = own.step(0)
        assert info["reference_c"] == course[k]
        assert reward == -step_cost(info["temp_air_c"] - course[k], 0.0, 0.0)


def test_the_air_is_shown_as_the_sensor_shows_it():
    noisy, exact = env(ambient_c=21.0), env(ambient_c=21.0, noise=False)
    shown, true = [], []
    for own in (noisy, exact):
        own.reset(seed=1)
        for _ in range(50):
            seen, _, _, _, info = own.step(5)
            shown.append(seen[0])
            true.append(info["temp_air_c"])
    shown, true = np.array(shown), np.array(true)
    assert np.abs(shown[50:] - true[50:]).max() < 1e-5
    assert 0.0 < np.abs(shown[:50] - true[:50]).std() < 0.1
    assert np.abs(shown[:50] * 10.0 - (shown[:50] * 10.0).round()).max() < 1e-3  # steps of 0.1 K


def test_heat_warms_and_the_fan_cools():
    def end(action):
        own = env(reference=28.0, ambient_c=21.0)
        own.reset(seed=1)
        return [own.step(action)[4]["temp_air_c"] for _ in range(10)][-1]

    assert end(LEVELS - 1) > end(0) > end(LEVELS)


def test_both_kinds_of_actions_do_the_same():
    chosen, given = env(), env(continuous=True)
    chosen.reset(seed=1), given.reset(seed=1)
    for action, pair in ((7, (0.36, 0.2)), (LEVELS + 20, (1.0, 0.5)), (0, (float("nan"), float("nan")))):
        one, other = chosen.step(action)[4], given.step(np.array(pair, np.float32))[4]
        assert one == other


def test_an_episode_ends_by_time_alone():
    own = env(steps=3)
    with pytest.raises(ResetNeeded):
        own.step(0)
    own.reset(seed=1)
    ends = [own.step(0)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    with pytest.raises(ResetNeeded):
        own.step(0)


def test_an_uncertain_twin_is_another_one_in_each_episode_and_stays_in_its_intervals():
    own, file = env(uncertain=True), read_twin_file(PACKAGED_TWIN)
    drawn = []
    for _ in range(5):
        own.reset(seed=None if drawn else 4)
        drawn.append(own.twin)
    assert len({twin.sha256 for twin in drawn}) == 5
    mass = file.effects["wall_mass"]["C_w"]
    assert all(mass.low <= twin.effects["wall_mass"]["C_w"] <= mass.high for twin in drawn)
    again = env(uncertain=True)
    again.reset(seed=4)
    assert again.twin.sha256 == drawn[0].sha256


def test_a_drawn_reference_can_be_reached():
    own = env(ambient_c=20.0)
    for seed in range(10):
        own.reset(seed=seed)
        course = own._course.reference
        # The full heater of the packaged twin reaches 22.5 K in the end: 0.6 of it, and a tenth of that.
        assert 21.3 < course.min() <= course.max() < 33.6


def test_the_full_heater_reaches_what_its_limit_and_the_loss_leave(tmp_path: Path):
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {wall_loss: {UA: 5.0}, heater_saturation: {u_sat: 0.7}}\n")
    assert full_rise_k(read_twin_file(path).twin()) == pytest.approx(0.7 * 100.0 / 5.0)
    assert full_rise_k(BoxTwin()) == math.inf  # the paper's box loses nothing with its fan off


def test_a_drawn_lamp_is_on_and_off_by_turns():
    light = draw_light(np.random.default_rng(1), EpisodeSettings(steps=600))
    assert len(light) == 601
    assert set(light) == {0.0, 1.0}
    assert 600 / 90 - 1 <= np.abs(np.diff(light)).sum() <= 60  # a state holds for 10 to 89 steps


def test_a_profile_is_a_reference(tmp_path: Path):
    path = tmp_path / "course.csv"
    path.write_text("time_s,reference_c\n0,24\n120,26\n")
    own = env(reference=path, steps=4)
    own.reset(seed=1)
    assert [own.step(0)[4]["reference_c"] for _ in range(4)] == [24.0, 24.0, 26.0, 26.0]


def test_wrong_files_and_columns_are_named(tmp_path: Path):
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {wall_loss: {UA: {fit: true, start: 5.0}}}\n")
    with pytest.raises(DataError, match=r"twin.yaml: effects.wall_loss.UA: is still to be fitted"):
        GreenhouseEnv(path)
    path.write_text("effects: {wall_loss: {UA: 5.0}}\n")
    with pytest.raises(DataError, match="no value of the twin has a confidence interval"):
        GreenhouseEnv(path, uncertain=True)
    with pytest.raises(DataError, match="ambient_c: not a number"):
        GreenhouseEnv(ambient_c=[20.0, np.nan])
    (tmp_path / "inputs.csv").write_text("time_s,heater_duty,fan_on\n0,0,0\n60,0,0\n")
    with pytest.raises(DataError, match=r"inputs.csv: reference_c: missing"):
        GreenhouseEnv(reference=tmp_path / "inputs.csv")


def test_a_line_tells_of_a_step():
    own = env(render_mode="ansi", reference=25.0, ambient_c=21.0)
    assert own.render() is None
    own.reset(seed=1)
    own.step(LEVELS)
    assert "reference  25.00 °C" in own.render()
    assert "heater 0.00  fan 1" in own.render()
