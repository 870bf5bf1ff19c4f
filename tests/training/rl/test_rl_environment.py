"""The environments of reinforcement learning: models that step side by side, episodes, reward, checkers."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.lab.episodes import EpisodeSettings, Sensor, draw_ambient, draw_reference
from edge.models.policy_actions import LEVELS
from edge.models.policy_observation import NAMES
from edge.twin.twin_file import read_twin_file
from training.data.datasets import training_runs
from training.models.predictors import GuardedHamPredictor, WindowPredictor
from training.models.summary import best_seed, records
from training.models.weights import load_network
from training.models.window_network import WINDOW
from training.rl.boxes import START_ROWS, EpisodeBoxes, World
from training.rl.episodes import DrawnEpisodes, Episode, EpisodeStart
from training.rl.models import Window
from training.rl.read_model import KEPT, TRAINED, draw_twins, read_model
from training.rl.reward import WEIGHTS, Weights, reward
from training.rl.study import play
from training.rl.vec_env import OBSERVATION_SPACE, BoxesVecEnv

SHORT = EpisodeSettings(steps=12)
TWIN = TRAINED / "ham_guarded" / "interpolation" / "seed_0" / "twin.yaml"
EXACT = Sensor(noise_sd_k=0.0, quantisation_k=1e-9)
COLUMNS = ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")


@pytest.fixture(scope="module")
def runs():
    return training_runs("interpolation")


def world_of(runs, name="ham", settings=SHORT, variants=1):
    return World(read_model(name, variants), DrawnEpisodes(runs, START_ROWS, settings), WEIGHTS["RL-Off-P"])


# models


@pytest.mark.parametrize("name", KEPT)
def test_a_model_steps_as_its_predictor_forecasts(name, runs):
    columns = [runs[2].columns[key] for key in COLUMNS]
    now, steps = 60, 20
    temp, ambient, duty, fan = columns
    window = Window(*(column[None, now + 1 - WINDOW : now + 1] for column in columns))
    model = read_model(name)
    one = np.zeros(1, dtype=np.intp)
    state, temps = model.start(window, one), []
    for k in range(now, now + steps):
        state, air = model.advance(state, ambient[k : k + 1], duty[k : k + 1], fan[k : k + 1], one)
        temps.append(air[0])
    history = {"temp_air": temp, "temp_ambient": ambient, "heater_duty": duty, "fan_on": fan}
    history = {key: column[now + 1 - WINDOW : now + 1] for key, column in history.items()}
    controls = np.stack([duty, fan], axis=-1)[None, now : now + steps]
    expected = predictor(name).rollout(history, controls, {"temp_ambient": ambient[now : now + steps]})[0]
    assert np.abs(np.array(temps) - expected).max() < 1e-3


def predictor(name):
    from edge.models.pbm import read_twin

    kept = KEPT[name]
    folder = TRAINED / kept / "interpolation" / f"seed_{best_seed(records(TRAINED), kept, 'interpolation')}"
    if name == "pbm":
        return read_twin(folder / "twin.yaml")
    network, _ = load_network(folder / "network.pt")
    return WindowPredictor(network) if name == "lstm" else GuardedHamPredictor(network)


def test_a_twin_file_can_be_the_model(runs):
    played = play(lambda seen: np.zeros(len(seen), dtype=int), world_of(runs, str(TWIN)), count=2)
    assert np.isfinite(played.mae_k)


def test_drawn_parameters_lie_in_their_intervals_and_differ():
    file = read_twin_file(TWIN)
    twins, again = draw_twins(file, 20, seed=1), draw_twins(file, 20, seed=1)
    assert [twin.sha256 for twin in again] == [twin.sha256 for twin in twins]
    assert twins[0].sha256 == file.twin().sha256
    assert len({twin.sha256 for twin in twins}) == 20
    for twin in twins[1:]:
        for (section, *place), value in file.values().items():
            if section == "effects" and value.low is not None:
                assert value.low <= twin.effects[place[0]][place[1]] <= value.high


def test_boxes_of_different_parameters_warm_differently(runs):
    model = read_model("ham", variants=3)
    window = Window(*(np.tile(runs[0].columns[key][:WINDOW], (3, 1)) for key in COLUMNS))
    variant = np.arange(3)
    state = model.start(window, variant)
    for _ in range(20):
        state, air = model.advance(state, np.full(3, 22.0), np.ones(3), np.zeros(3), variant)
    assert len(set(air.round(3))) == 3


def test_an_lstm_has_no_parameters_to_draw():
    with pytest.raises(DataError, match="no physical parameters"):
        read_model("lstm", variants=2)


def test_a_twin_without_intervals_has_nothing_to_draw(tmp_path: Path):
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {wall_loss: {UA: 5.0}}\n")
    with pytest.raises(DataError, match="no value of the twin has a confidence interval"):
        read_model(str(path), variants=2)


# reward


def test_the_reward_is_the_papers():
    # tab:model-parameters-rl: 0.5 e^2 + 1 |e| + 0.5 u_f + 0.1 u_h
    error, duty, fan = np.array([2.0, -2.0]), np.array([0.5, 0.0]), np.array([1.0, 0.0])
    assert reward(error, duty, fan, WEIGHTS["RL-Off-P"]) == pytest.approx([-(2 + 2 + 0.5 + 0.05), -4.0])
    assert reward(error, duty, fan, WEIGHTS["RL-Off"]) == pytest.approx([-4.0, -4.0])


def test_all_variants_with_penalty_have_the_same_weights():
    assert WEIGHTS["RL-Off-P"] == WEIGHTS["RL-On-P"] == WEIGHTS["RL-Tr-P"] == Weights(0.5, 1.0, 0.5, 0.1)


# episodes


def test_references_stay_in_their_range_and_are_never_twice_the_same():
    courses = [
        draw_reference(np.random.default_rng(seed), EpisodeSettings(steps=600), 21.0) for seed in range(20)
    ]
    for course in courses:
        assert course.min() >= 22.0
        assert course.max() <= 35.0
    assert len({course.tobytes() for course in courses}) == len(courses)


def test_a_reference_below_the_room_is_not_asked_for():
    course = draw_reference(np.random.default_rng(1), EpisodeSettings(steps=600), 25.0)
    assert course.min() >= 25.5


def test_references_have_steps_and_ramps():
    course = draw_reference(np.random.default_rng(2), EpisodeSettings(steps=2000), 21.0)
    changes = np.abs(np.diff(course))
    ramps = sum(0.0 < a < 1.5 and abs(a - b) < 1e-9 for a, b in pairwise(changes))
    assert (changes > 2.0).sum() > 5
    assert ramps > 50


def test_a_sensor_shows_steps_of_its_resolution():
    shown = Sensor(0.03, 0.1).shows(np.full(1000, 24.03), np.random.default_rng(1))
    assert np.allclose(shown * 10.0, np.round(shown * 10.0))
    assert 24.0 < shown.mean() < 24.06


class GivenEpisode:
    """The same episode every time."""

    def __init__(self, episode: Episode) -> None:
        self.episode, self.steps = episode, len(episode.reference) - 1

    def draw(self, rng: np.random.Generator) -> Episode:
        return self.episode


def test_an_episode_that_is_given_is_lived_through():
    steps = 5
    still = np.full(START_ROWS, 24.0)
    start = EpisodeStart(still, np.full(START_ROWS, 22.0), np.full(START_ROWS, 0.1), np.zeros(START_ROWS))
    episode = Episode(np.linspace(25.0, 26.0, steps + 1), np.full(steps + 1, 22.0), start)
    boxes = EpisodeBoxes(
        World(read_model("ham"), GivenEpisode(episode), WEIGHTS["RL-Off"], EXACT),
        2,
        np.random.default_rng(0),
    )
    seen = boxes.reset()
    assert seen[0, NAMES.index("error")] * 5.0 == pytest.approx(1.0)
    assert seen[0, NAMES.index("duty_30")] == pytest.approx(0.1)
    stepped = [boxes.step(np.array([LEVELS - 1, 0])) for _ in range(steps)]
    assert [step.ended.all() for step in stepped] == [False] * (steps - 1) + [True]
    assert stepped[-1].error_k[0] > stepped[-1].error_k[1]  # full heat against none
    assert stepped[-1].observation[0, NAMES.index("duty_5")] == 1.0


# environments


def test_the_same_seed_gives_the_same_episodes_inside_the_space(runs):
    def episodes(seed):
        env = BoxesVecEnv(world_of(runs), 2, seed)
        return np.array([env.reset(), *(env.step(np.array([k, k + 1]))[0] for k in range(SHORT.steps))])

    seen = episodes(5)
    assert all(OBSERVATION_SPACE.contains(one) for one in seen.reshape(-1, seen.shape[-1]))
    assert np.array_equal(seen, episodes(5))
    assert not np.array_equal(seen, episodes(6))


def test_one_box_of_many_is_as_one_alone(runs):
    alone = EpisodeBoxes(world_of(runs), 1, np.random.default_rng(4))
    env = BoxesVecEnv(world_of(runs), 1, seed=4)
    assert np.array_equal(alone.reset().astype(np.float32), env.reset())
    for action in (0, 13, 41):
        seen, earned, _, _ = env.step(np.array([action]))
        stepped = alone.step(np.array([action]))
        assert np.array_equal(seen, stepped.observation.astype(np.float32))
        assert earned[0] == np.float32(stepped.reward[0])


def test_a_box_whose_time_is_over_begins_anew_and_tells_its_last(runs):
    env = BoxesVecEnv(world_of(runs), 3, seed=1, reward_scale=0.5)
    env.reset()
    for _ in range(SHORT.steps):
        seen, _, done, infos = env.step(np.zeros(3, dtype=int))
    assert done.all()
    for row, info in zip(seen, infos, strict=True):
        assert info["TimeLimit.truncated"]
        assert not np.array_equal(info["terminal_observation"], row)
    assert not env.step(np.zeros(3, dtype=int))[2].any()


def test_the_room_wanders_about_the_mean_that_was_drawn():
    settings = EpisodeSettings(steps=1, ambient_c=(21.0, 21.0))
    begins = [draw_ambient(np.random.default_rng(seed), settings)[0] for seed in range(400)]
    assert np.mean(begins) == pytest.approx(21.0, abs=3.0 * settings.ambient_wander_k / 20.0)
