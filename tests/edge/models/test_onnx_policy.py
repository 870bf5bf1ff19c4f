"""A policy's file: what it promises is checked before it is believed."""

import numpy as np
import pytest
from policy_files import document, graph, policy_file, weights_of, write

from edge.core.errors import DataError
from edge.models.onnx_policy import read_policy
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES


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
