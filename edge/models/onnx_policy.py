"""A trained policy as an ONNX file; it has proved its golden values when it is there."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.formats.input_file import MODEL, Source, read_file
from edge.models.onnx_predictor import one_line, open_session
from edge.models.policy_actions import ACTIONS
from edge.models.policy_contract import KEY, TOLERANCE, PolicyContract, parse_policy_contract
from edge.models.policy_observation import FEATURES, Floats

INPUT, OUTPUT = "observation", "values"


@dataclass(frozen=True, slots=True, eq=False)
class OnnxPolicy:
    """The graph in an onnxruntime session."""

    name: str
    version: str
    contract: PolicyContract
    session: Any

    @property
    def step_s(self) -> float:
        """The control step that it was trained with [s]."""
        return self.contract.sample_s

    def values(self, observations: Floats) -> Floats:
        """Return the value of each action, [B, ACTIONS]. observations : [B, features]. Errors: DataError"""
        try:
            values = self.session.run([OUTPUT], {INPUT: observations.astype(np.float32)})[0]
        except Exception as error:  # onnxruntime's own errors have no other base
            raise DataError(f"{self.name}: cannot be run: {one_line(error)}") from error
        return np.asarray(values, dtype=np.float64)

    def prove(self) -> None:
        """Run the golden observations. Errors: DataError"""
        expected = self.contract.values
        values = self.values(self.contract.observations)
        if values.shape != expected.shape:
            raise DataError(f"golden.values: shape {expected.shape}, not {values.shape}")
        missed = np.abs(values - expected).max()
        if not missed <= TOLERANCE:  # NaN misses too
            raise DataError(f"golden.values: missed by {missed:.2g}, {TOLERANCE:g} is allowed")
        if (values.argmax(axis=1) != expected.argmax(axis=1)).any():
            raise DataError("golden.values: another action than the trained network's")


def read_policy(path: Source, name: str, step_s: float | None = None) -> OnnxPolicy:
    """Read the policy in `path`; its version is the first 12 hex digits of the file's sha256.

    step_s : the control step that it has to be made for [s], None for any
    Errors : DataError that names the file and the key
    """
    try:
        content = read_file(path, MODEL)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        session = open_session(content)
        _check_shapes(session)
        text = session.get_modelmeta().custom_metadata_map.get(KEY)
        if text is None:
            raise DataError(f"{KEY}: missing in the metadata: not a policy of this project")
        contract = parse_policy_contract(text)
        if step_s is not None and contract.sample_s != step_s:
            raise DataError(f"sample_s: made for steps of {contract.sample_s:g} s, not of {step_s:g} s")
        policy = OnnxPolicy(name, hashlib.sha256(content).hexdigest()[:12], contract, session)
        policy.prove()
    except DataError as error:
        raise DataError(f"{path}: {error}") from error.__cause__
    return policy


def _check_shapes(session: Any) -> None:
    found = {item.name: list(item.shape) for item in (*session.get_inputs(), *session.get_outputs())}
    expected = {INPUT: ["B", len(FEATURES)], OUTPUT: ["B", ACTIONS]}
    if found != expected:
        raise DataError(f"inputs and outputs: {found} are not {expected}")
