"""A policy's file, whose promises are checked before it is believed, and what it observes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from contexts import context
from policy_files import document, graph, policy_file, weights_of, write

from edge.core.errors import DataError
from edge.core.messages import Command
from edge.formats.run_file import read_run
from edge.models import policy_observation as observation
from edge.models.onnx_policy import read_policy
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import (
    AIR_ROWS,
    FEATURES,
    INPUT_ROWS,
    NAMES,
    Recent,
    by_name,
    observe,
    observe_tick,
    table_sha256,
)
from training.data.datasets import RUNS


def test_a_policy_gives_the_values_of_its_graph(tmp_path):
    policy = read_policy(policy_file(tmp_path / "p.onnx", favourite=3), "RL-Off", 60.0)
    observations = np.random.default_rng(1).normal(size=(5, len(FEATURES)))
    assert np.allclose(policy.values(observations), observations @ weights_of(3), atol=1e-3)
    assert (policy.name, policy.step_s, len(policy.version)) == ("RL-Off", 60.0, 12)


def golden(**changed):
    return document() | {"golden": document()["golden"] | changed}


@pytest.mark.parametrize(
    ("contract", "problem"),
    [
        (None, "greenhouse_policy: missing in the metadata"),
        (document() | {"policy": 2}, "policy: 2 is not 1"),
        (document() | {"table_sha256": "0" * 64}, "table_sha256: made with another table"),
        (document() | {"features": ["error"]}, "features: "),
        (document() | {"actions": 41}, "actions: 41 is not 42"),
        (document() | {"sample_s": 0}, "sample_s: 0 is not above 0"),
        (golden(observations=[]), "golden.observations: not numbers in 2 dimensions"),
        (golden(observations=[[1.0] * 12]), r"golden.observations: shape \(1, 12\), not \(1, 13\)"),
        (golden(values=[[0.0] * ACTIONS]), r"golden.values: shape \(1, 42\), not \(3, 42\)"),
        (golden(values=[[0.0] * ACTIONS] * 3), "golden.values: missed by 1e\\+02"),
        (document(favourite=8), "golden.values: missed by 1e\\+02"),
    ],
)
def test_a_file_that_breaks_its_word_is_refused_by_the_key(tmp_path, contract, problem):
    path = write(tmp_path / "p.onnx", graph(), contract)
    with pytest.raises(DataError, match=f"p.onnx: {problem}"):
        read_policy(path, "RL-Off")


def test_a_graph_of_another_shape_is_refused(tmp_path):
    path = write(tmp_path / "p.onnx", graph(features=5), document())
    with pytest.raises(DataError, match="inputs and outputs"):
        read_policy(path, "RL-Off")


def test_a_policy_for_another_step_is_refused(tmp_path):
    path = policy_file(tmp_path / "p.onnx", sample_s=30.0)
    with pytest.raises(DataError, match="sample_s: made for steps of 30 s, not of 60 s"):
        read_policy(path, "RL-Off", 60.0)


def test_what_is_no_onnx_file_is_refused(tmp_path):
    (tmp_path / "p.onnx").write_bytes(b"nonsense")
    with pytest.raises(DataError, match="not an ONNX file"):
        read_policy(tmp_path / "p.onnx", "RL-Off")
    with pytest.raises(DataError, match="cannot be read"):
        read_policy(tmp_path / "none.onnx", "RL-Off")


# the table of the observation: what each row is, and that rig and training compute the same


NAN = math.nan


def test_a_box_at_rest_sees_its_error_and_how_it_is_heated():
    seen = by_name(observe_tick(context(24.0, 26.0, Command(heater_duty=0.35, fan_on=True), rows=40)))
    assert seen["error"] == 2.0
    assert seen["error_near"] == 1.0  # held within 1 K
    assert seen["above_room"] == 3.0  # the room of the tests has 21 °C
    assert [seen[name] for name in NAMES if name.startswith("change")] == [0.0, 0.0, 0.0]
    assert [seen[name] for name in NAMES if name.startswith("duty")] == [0.35] * 4
    assert [seen[name] for name in NAMES if name.startswith("fan")] == [1.0] * 3


def test_a_change_is_told_over_its_steps():
    here = context(rows=40)
    here.history["temp_air"][-6:] = [20.0, 21.0, 22.5, 23.0, 23.5, 24.0]
    seen = by_name(observe_tick(here))
    assert (seen["change_1"], seen["change_2"], seen["change_5"]) == (0.5, 1.0, 4.0)


def test_means_of_the_heater_cover_their_steps():
    here = context(rows=40)
    here.history["heater_duty"][:-1] = 0.0
    here.history["heater_duty"][-4:-1] = 1.0  # of the last three steps; the last row is not decided
    seen = by_name(observe_tick(here))
    assert seen["duty_1"] == 1.0
    assert [seen[f"duty_{steps}"] for steps in (5, 10, 30)] == pytest.approx([0.6, 0.3, 0.1])


def test_a_rig_that_has_just_begun_is_as_it_was_and_off_before():
    seen = by_name(observe_tick(context(24.0, 26.0, Command(heater_duty=1.0), rows=2)))
    assert seen["change_5"] == 0.0
    assert seen["duty_1"] == 1.0
    assert seen["duty_10"] == pytest.approx(0.1)


def test_only_the_present_reference_is_seen():
    steady, rising = context(reference=[25.0, 25.0]), context(reference=[25.0, 30.0])
    assert np.array_equal(observe_tick(steady), observe_tick(rising))


@pytest.mark.parametrize(
    ("column", "row", "named"),
    [
        ("temp_air", -1, "error, "),
        ("temp_air", -2, "change_1"),
        ("heater_duty", -2, "duty_1, duty_5"),
        ("fan_on", -3, "fan_5, fan_10"),
    ],
)
@pytest.mark.parametrize("unknown", [NAN, math.inf])
def test_what_is_not_known_is_refused_by_name(column, row, named, unknown):
    here = context(rows=40)
    here.history[column][row] = unknown
    with pytest.raises(DataError, match=f"observation: {named}"):
        observe_tick(here)


def test_an_unknown_room_or_reference_is_refused():
    here = context()
    with pytest.raises(DataError, match="above_room"):
        observe_tick(replace(here, estimate=replace(here.estimate, temp_ambient=NAN)))
    with pytest.raises(DataError, match="error"):
        observe_tick(replace(here, reference=np.array([NAN])))


def test_no_history_is_refused():
    here = context()
    none = {name: column[:0] for name, column in here.history.items()}
    with pytest.raises(DataError, match="no history"):
        observe_tick(replace(here, history=none))


def test_the_rig_sees_at_recorded_ticks_what_training_sees():
    columns = read_run(RUNS / "run_03.csv").columns
    temp, ambient, duty, fan = (
        columns[name] for name in ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
    )
    ends = np.arange(INPUT_ROWS, len(temp))
    recent = Recent(
        air=np.stack([temp[end - AIR_ROWS + 1 : end + 1] for end in ends]),
        duty=np.stack([duty[end - INPUT_ROWS : end] for end in ends]),
        fan=np.stack([fan[end - INPUT_ROWS : end] for end in ends]),
        ambient=ambient[ends],
        reference=np.full(len(ends), 27.5),
    )
    together = observe(recent)
    for row, end in enumerate(ends):
        history = {
            "temp_air": temp[: end + 1],
            "heater_duty": np.append(duty[:end], NAN),
            "fan_on": np.append(fan[:end], NAN),
        }
        here = replace(context(reference=27.5), history=history)
        here = replace(here, estimate=replace(here.estimate, temp_ambient=ambient[end]))
        assert np.array_equal(observe_tick(here), together[row])


def test_every_row_of_the_table_says_what_it_is():
    assert len(set(NAMES)) == len(FEATURES)
    assert all(feature.unit and feature.meaning and feature.scale > 0.0 for feature in FEATURES)


def test_another_table_has_another_hash(monkeypatch):
    before = table_sha256()
    changed = (replace(FEATURES[0], scale=FEATURES[0].scale * 2.0), *FEATURES[1:])
    monkeypatch.setattr(observation, "FEATURES", changed)
    assert table_sha256() != before
