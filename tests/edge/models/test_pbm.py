import numpy as np
import pytest

from edge.core.errors import DataError
from edge.core.predictor import Predictor
from edge.models.pbm import Pbm, read_twin
from edge.twin.model import BoxTwin
from edge.twin.warm_start import PastColumns, at_rest, hold, state_now

HIDDEN = {
    "wall_mass": {"C_w": 20000.0, "G_in": 8.0, "G_out": 8.0},
    "heater_lag": {"tau_h": 600.0},
    "extra_capacity": {"kC": 6.0},
}
ROWS = 60


def past_of(twin, rows=ROWS, seed=0, noise_k=0.0, start=None):
    """History of a twin with a heater that changes every few minutes, and its state at the last row."""
    rng = np.random.default_rng(seed)
    duty, fan = np.repeat(rng.uniform(0.0, 0.6, rows // 5 + 1), 5)[:rows], np.zeros(rows)
    fan[rows // 2 : rows // 2 + 3] = 1.0
    state = at_rest(twin, 24.0, 21.0) if start is None else start
    temps = [state[0]]
    for k in range(rows - 1):
        state = twin.advance(state, 21.0, duty[k], fan[k])
        temps.append(state[0])
    history = {
        "temp_air": np.array(temps) + rng.normal(0.0, noise_k, rows),
        "temp_ambient": np.full(rows, 21.0),
        "heater_duty": np.append(duty[:-1], np.nan),  # the last row's inputs are not decided yet
        "fan_on": np.append(fan[:-1], np.nan),
    }
    return history, state


def ahead(steps, **columns):
    return {"temp_ambient": np.full(steps, 21.0), **columns}


def last(history, rows):
    return {name: values[-rows:] for name, values in history.items()}


def test_it_is_a_predictor_named_pbm():
    model: Predictor = Pbm()
    assert (model.name, model.step_s, model.rows_needed) == ("pbm", 60.0, 1)
    assert model.version == BoxTwin().sha256[:12]


def test_two_steps_are_the_equation_by_hand():
    history = {"temp_air": np.array([22.0])}
    controls = np.array([[[0.05, 0.0], [0.0, 1.0]]])
    first = 22.0 + 300.0 / (1.2 * 1005.0 * 0.15)  # 5 W for 60 s
    second = 21.0 + (first - 21.0) * np.exp(-68.0 / 60.0 / 0.15)
    np.testing.assert_allclose(Pbm().rollout(history, controls, ahead(2))[0], [first, second])


def test_a_batch_is_its_rows():
    model = Pbm(BoxTwin(effects=HIDDEN))
    history, _ = past_of(model.twin)
    controls = np.random.default_rng(1).uniform(size=(5, 12, 2))
    together = model.rollout(history, controls, ahead(12))
    assert together.shape == (5, 12)
    for row in range(5):
        alone = model.rollout(history, controls[row : row + 1], ahead(12))[0]
        np.testing.assert_allclose(together[row], alone, atol=1e-9)


def test_the_offset_is_carried_on_and_longer_columns_are_cut():
    controls, history = np.zeros((1, 2, 2)), {"temp_air": np.array([22.0])}
    moved = Pbm().rollout(history, controls, ahead(5, offset=np.full(5, 0.1)))
    np.testing.assert_allclose(moved[0], [22.1, 22.2])


def test_hidden_states_are_those_of_a_box_of_the_same_physics():
    model = Pbm(BoxTwin(effects=HIDDEN))
    start = at_rest(model.twin, 24.0, 21.0) + np.array([0.0, 2.0, 25.0])  # a wall and an element off rest
    history, state = past_of(model.twin, start=start)
    controls = np.tile([0.2, 0.0], (1, 30, 1))
    true = model.twin.rollout(state, controls[..., 0], controls[..., 1], 21.0)
    np.testing.assert_allclose(model.rollout(history, controls, ahead(30)), true, atol=0.1)


def test_more_rows_tell_hidden_states_better():
    model = Pbm(BoxTwin(effects=HIDDEN))
    errors = {1: [], 10: [], 60: []}
    for seed in range(10):
        start = at_rest(model.twin, 24.0, 21.0) + np.array([0.0, 2.0, 25.0])
        history, state = past_of(model.twin, seed=seed, noise_k=0.05, start=start)
        controls = np.zeros((1, 20, 2))
        true = model.twin.rollout(state, controls[..., 0], controls[..., 1], 21.0)
        for rows, found in errors.items():
            found.append(np.abs(model.rollout(last(history, rows), controls, ahead(20)) - true).mean())
    assert np.mean(errors[60]) < np.mean(errors[10]) < np.mean(errors[1])


def test_the_last_rows_inputs_are_not_read():
    model = Pbm(BoxTwin(effects=HIDDEN))
    history, _ = past_of(model.twin)
    other = {name: values.copy() for name, values in history.items()}
    other["heater_duty"][-1], other["fan_on"][-1] = 1.0, 1.0
    controls = np.full((1, 3, 2), 0.5)
    np.testing.assert_array_equal(
        model.rollout(history, controls, ahead(3)), model.rollout(other, controls, ahead(3))
    )


def test_it_starts_at_the_last_measured_temperature():
    twin = BoxTwin(effects=HIDDEN)
    history, _ = past_of(twin)
    history["temp_air"][-1] += 0.7
    past = PastColumns(*(history[name] for name in ("temp_air", "temp_ambient", "heater_duty", "fan_on")))
    assert state_now(twin, past)[0] == history["temp_air"][-1]


@pytest.mark.parametrize("effects", [{}, HIDDEN], ids=["bare", "hidden states"])
def test_missing_readings_are_bridged(effects):
    model = Pbm(BoxTwin(effects=effects, step_s=10.0))
    history, state = past_of(model.twin)
    history["temp_air"][[0, 5, 6, -1]] = np.nan
    history["temp_ambient"][[0, 7, -1]] = np.nan
    controls = np.zeros((1, 5, 2))
    true = model.twin.rollout(state, controls[..., 0], controls[..., 1], 21.0)
    np.testing.assert_allclose(model.rollout(history, controls, ahead(5)), true, atol=0.3)


@pytest.mark.parametrize("effects", [{}, HIDDEN], ids=["bare", "hidden states"])
def test_a_history_without_any_temperature_is_refused(effects):
    model = Pbm(BoxTwin(effects=effects))
    history, _ = past_of(model.twin)
    with pytest.raises(DataError, match=r"^history: no air temperature is known"):
        model.rollout({**history, "temp_air": np.full(ROWS, np.nan)}, np.zeros((1, 2, 2)), ahead(2))
    with pytest.raises(DataError, match=r"^history: no row"):
        model.rollout(last(history, -ROWS), np.zeros((1, 2, 2)), ahead(2))


def test_hidden_states_need_the_room_once():
    model = Pbm(BoxTwin(effects=HIDDEN))
    history, _ = past_of(model.twin)
    with pytest.raises(DataError, match=r"^history: no room temperature is known"):
        model.rollout({**history, "temp_ambient": np.full(ROWS, np.nan)}, np.zeros((1, 2, 2)), ahead(2))


def test_a_value_holds_until_the_next_and_the_first_before_it():
    values = np.array([np.nan, 1.0, np.nan, 2.0, np.nan])
    np.testing.assert_array_equal(hold(values), [1.0, 1.0, 1.0, 2.0, 2.0])
    assert np.isnan(hold(np.full(2, np.nan))).all()


def test_a_twin_file_is_read_as_a_predictor(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text("sample_s: 30\neffects: {wall_loss: {UA: {value: 5.1, low: 4.8, high: 5.4}}}\n")
    model = read_twin(path)
    assert (model.step_s, model.twin.effects) == (30.0, {"wall_loss": {"UA": 5.1}})


def test_a_value_that_is_still_to_be_fitted_predicts_nothing(tmp_path):
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {wall_loss: {UA: {fit: true}}}\n")
    with pytest.raises(DataError, match=r"twin\.yaml: effects\.wall_loss\.UA: is still to be fitted"):
        read_twin(path)
