"""A predictor whose whole rollout is one ONNX graph; it has proved its contract when it is there.

onnxruntime is imported when a file is read and not before: a rig without such a model never pays for it.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Columns, Floats
from edge.formats.input_file import MODEL, Source, read_file
from edge.models.contract import KEY, WITHOUT_A_TWIN, Contract, parse_contract


def open_session(content: bytes) -> Any:
    """Open a session on the bytes of an ONNX file. Errors: DataError where they cannot be run"""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # newer than the pinned version, it would call its maker
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # the other cores are not ours
    options.enable_cpu_mem_arena = False  # it keeps the memory of the largest batch for good
    options.log_severity_level = 4  # what goes wrong is raised
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its own errors have no other base
        raise DataError(f"not an ONNX file that can be run: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    """Its text, fit for an error of ours."""
    return " ".join(str(error).split())


# Sequences per call: states and gates of more of the LSTM's leave the cache, and each costs twice as much.
BATCH = {"lstm": 64, "window": 64, "ham": 1024, "ham_guarded": 1024}


@dataclass(frozen=True, slots=True, eq=False)
class OnnxPredictor:
    """The graph in an onnxruntime session, behind the call of every predictor.

    kind : which network it is, a key of `edge.models.contract.FEATURES`
    """

    name: str
    version: str
    contract: Contract
    session: Any

    @property
    def kind(self) -> str:
        """Which network it is, a key of `edge.models.contract.FEATURES`."""
        return self.contract.kind

    @property
    def step_s(self) -> float:
        """Time from one row to the next [s]."""
        return self.contract.sample_s

    @property
    def rows_needed(self) -> int:
        """Rows of history to start from, the last of them now."""
        return self.contract.window

    @property
    def validity(self) -> Mapping[str, tuple[float, float]]:
        """Lowest and highest value of each feature in the data of the training."""
        return self.contract.validity

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Air temperature after each control, as `edge.core.predictor.Predictor.rollout`.

        history : the contract's features; of the last row `temp_air` alone is read
        controls : [B, N, 2], heater_duty and fan_on
        ahead : `temp_ambient` [N] where it is a feature [°C], and optionally `offset` [N], what the model
            misses per step [K/step]
        Returns : [B, N] [°C]; NaN from the first step on that rests on a missing number
        Raises : DataError when the history is too short
        """
        batch, horizon, _ = controls.shape
        rows = len(history["temp_air"])
        if rows < self.rows_needed:
            raise DataError(f"history: {rows} rows, the {self.name} model needs {self.rows_needed}")
        window = np.stack(
            [history[name][rows - self.rows_needed :] for name in self.contract.features], axis=1
        )
        window[-1, 1:] = 0.0  # not decided yet
        # A graph is not trusted with NaN: some kernels answer with a number.
        if not np.isfinite(window).all() or not horizon:
            return np.full((batch, horizon), np.nan)
        steps = {"offset": ahead["offset"][:horizon] if "offset" in ahead else np.zeros(horizon)}
        if "temp_ambient" in self.contract.features:
            steps["ambient"] = ahead["temp_ambient"][:horizon]
        temps = self._run(window, controls, steps)
        known = np.isfinite(controls).all(axis=2) & np.isfinite(list(steps.values())).all(axis=0)
        temps[~np.logical_and.accumulate(known, axis=1)] = np.nan  # the kernels may turn NaN into a number
        return temps

    def _run(self, window: Floats, controls: Floats, steps: Mapping[str, Floats]) -> Floats:
        """Run the graph in batches; window [rows, features], controls [B, N, 2], steps [N] each."""
        feed = {name: values.astype(np.float32) for name, values in {"window": window, **steps}.items()}
        size = BATCH[self.kind]
        parts = [
            self.session.run(["temps"], feed | {"controls": part.astype(np.float32)})[0]
            for part in np.split(controls, range(size, len(controls), size))
        ]
        return np.concatenate(parts).astype(np.float64)

    def prove(self) -> None:
        """Run the golden vectors. Errors: DataError that names the vector."""
        for i, golden in enumerate(self.contract.golden):
            place, horizon = f"golden[{i}]", golden.temps.shape[1]
            steps = {"offset": np.zeros(horizon)}
            if golden.ambient is not None:
                steps["ambient"] = golden.ambient
            try:
                temps = self._run(golden.window, golden.controls, steps)
            except Exception as error:  # onnxruntime's own errors have no other base
                raise DataError(f"{place}: cannot be run: {one_line(error)}") from error
            if temps.shape != golden.temps.shape:
                raise DataError(f"{place}.temps: shape {golden.temps.shape}, not {temps.shape}")
            limit = self.contract.step_tolerance_k if horizon == 1 else self.contract.rollout_tolerance_k
            missed = np.abs(temps - golden.temps).max()
            if not missed <= limit:  # NaN misses too
                raise DataError(f"{place}.temps: missed by {missed:.2g} K, {limit:g} K is allowed")


def read_onnx(
    path: Source, name: str, kinds: Sequence[str], step_s: float | None, twin_sha256: str = ""
) -> OnnxPredictor:
    """Read the predictor in `path`; its version is the first 12 hex digits of the file's sha256.

    kinds : those that may be in it; step_s : the control step [s], None for any
    twin_sha256 : of the twin that a hybrid is to run on
    Raises : DataError that names the file and the key of the contract, or the golden vector that it misses
    """
    try:
        content = read_file(path, MODEL)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        session = open_session(content)
        contract = _contract(session)
        _check_use(contract, kinds, step_s, twin_sha256)
        _check_shapes(contract, session)
        predictor = OnnxPredictor(name, hashlib.sha256(content).hexdigest()[:12], contract, session)
        predictor.prove()
    except DataError as error:
        raise DataError(f"{path}: {error}") from error.__cause__
    return predictor


def _contract(session: Any) -> Contract:
    text = session.get_modelmeta().custom_metadata_map.get(KEY)
    if text is None:
        raise DataError(f"{KEY}: missing in the metadata: not a model of this project")
    return parse_contract(text)


def _check_use(contract: Contract, kinds: Sequence[str], step_s: float | None, twin_sha256: str) -> None:
    if contract.kind not in kinds:
        raise DataError(f"kind: {contract.kind!r} is none of {', '.join(kinds)}")
    if step_s is not None and contract.sample_s != step_s:
        raise DataError(f"sample_s: made for steps of {contract.sample_s:g} s, the rig's are {step_s:g} s")
    if contract.twin_sha256 != twin_sha256:
        raise DataError(f"twin_sha256: trained on the twin {contract.twin_sha256}, not on {twin_sha256}")


def _check_shapes(contract: Contract, session: Any) -> None:
    """Check that the graph's inputs and outputs are those of the contract; a free size has a name."""
    features = contract.features
    expected = {"window": [contract.window, len(features)], "controls": ["B", "N", 2], "offset": ["N"]}
    if "temp_ambient" in features:
        expected["ambient"] = ["N"]
    found = {item.name: list(item.shape) for item in session.get_inputs()}
    if found != expected:
        raise DataError(f"inputs: {found} are not {expected}")
    if (given := [item.name for item in session.get_outputs()]) != ["temps"]:
        raise DataError(f"outputs: {given} are not ['temps']")


KINDS = ("ham", "ham_guarded")  # the paper's, and the one that falls back to its twin outside its data


def read_ham(path: Source, twin_sha256: str, step_s: float | None = None) -> OnnxPredictor:
    """Read the predictor "ham" in `path`, proved by its golden vectors; its `kind` names the hybrid.

    twin_sha256 : `Twin.sha256` of the twin beside it: a hybrid corrects one twin and no other
    step_s : the control step that it has to be made for [s], None for any
    Errors : DataError that names the file and the key
    """
    return read_onnx(path, "ham", KINDS, step_s, twin_sha256)


def read_lstm(path: Source, step_s: float | None = None) -> OnnxPredictor:
    """Read the predictor "lstm" in `path`, proved by its golden vectors; its `kind` is "window" where the
    file holds another network of the same window.

    step_s : the control step that it has to be made for [s], None for any
    Errors : DataError that names the file and the key
    """
    return read_onnx(path, "lstm", WITHOUT_A_TWIN, step_s)
