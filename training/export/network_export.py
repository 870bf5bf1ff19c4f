"""A trained network as an ONNX file that carries its contract: `edge/models/contract.py` says what is in it.

The file is read back as the rig reads it, golden vectors and all, before it counts as written.
"""

import argparse
import importlib.metadata
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from onnx import GraphProto, ModelProto

from edge.core.errors import DataError, GreenhouseError
from edge.core.predictor import Predictor
from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import RecordedRun, inside_names
from edge.models import contract
from edge.models.onnx_predictor import OnnxPredictor, read_ham, read_lstm
from edge.models.validity import box_of
from edge.twin.model import BoxTwin
from training.data.datasets import training_runs
from training.data.pairs import split_all
from training.export.ham_graph import ham_rollout
from training.export.lstm_graph import lstm_rollout
from training.export.onnx_graph import Graph, Shape, real
from training.export.onnx_step import single_step
from training.models.ham import GuardedHamNet, HamNet
from training.models.predictors import Network, eager
from training.models.registry import NETWORK_FILE
from training.models.study import RESULT_FILE, versions
from training.models.weights import load_network
from training.models.window_network import COLUMNS, WINDOW, LstmNet, WindowNet

GOLDEN_STEPS = 8  # single steps, spread over the run
GOLDEN_BATCH, GOLDEN_HORIZON = 3, 20
_SCALERS = ("mean", "scale", "target_mean", "target_scale", "source_mean", "source_scale")


@dataclass(frozen=True, slots=True)
class ExportFacts:
    """Facts that a network does not hold itself.

    validity : lowest and highest value of each column in its training data, as `edge.models.validity.box_of`
    twin_sha256 : of the twin that a hybrid corrects, "" for others
    metrics : any JSON values
    """

    command: str
    seed: int
    data_sha256: str
    validity: Mapping[str, tuple[float, float]]
    metrics: Mapping[str, Any]
    twin_sha256: str = ""
    sample_s: float = 60.0


def export(network: Network, facts: ExportFacts, run: RecordedRun, path: Path) -> OnnxPredictor:
    """Write `network` to `path`, prove it, and return what the rig will run.

    run : the golden vectors are forecasts of it: the whole run from its first rows, some shorter
    Errors : DataError for a run that is too short or has holes, and when the graph misses the network
    """
    predictor = eager(network)
    kind, model = predictor.name, _graph(network)
    document = {
        "contract": 1,
        "kind": kind,
        "features": list(contract.FEATURES[kind]),
        "units": contract.units(kind),
        "sample_s": facts.sample_s,
        "window": predictor.rows_needed,
        "scaler": {name: getattr(network, name).tolist() for name in _SCALERS if hasattr(network, name)},
        "validity": {key: list(facts.validity[key]) for key in contract.keys(kind)},
        "tolerance": {"step_k": contract.STEP_TOLERANCE_K, "rollout_k": contract.ROLLOUT_TOLERANCE_K},
        "golden": golden_vectors(predictor, contract.FEATURES[kind], run),
        "twin_sha256": facts.twin_sha256,
        "data_sha256": facts.data_sha256,
        "command": facts.command,
        "seed": facts.seed,
        "metrics": dict(facts.metrics),
        "software": versions() | {"onnx": importlib.metadata.version("onnx")},
    }
    # The contract travels inside the file: a graph and its scaler can't be mixed up.
    model.metadata_props.add(key=contract.KEY, value=json.dumps(document, allow_nan=False))
    write_atomically(path, model.SerializeToString(deterministic=True))
    if isinstance(network, WindowNet):
        return read_lstm(path, facts.sample_s)
    return read_ham(path, facts.twin_sha256, facts.sample_s)


def _graph(network: Network) -> ModelProto:
    match network:
        case LstmNet():  # a graph of its own that is faster than the general one
            return lstm_rollout(network, WINDOW)
        case WindowNet():
            return window_rollout(network)
        case HamNet():
            return ham_rollout(network, 1)
        case GuardedHamNet():
            return ham_rollout(network, WINDOW)


def golden_vectors(predictor: Predictor, features: Sequence[str], run: RecordedRun) -> list[dict[str, Any]]:
    """Rollouts of the network itself: the whole run, single steps all over it, and a batch; JSON values."""
    columns = {name: values for name, values in inside_names(run).items() if name in contract.FEATURES["ham"]}
    if any(not np.isfinite(values).all() for values in columns.values()):
        raise DataError(f"{run.path}: golden vectors need a run without missing readings")
    first, last = predictor.rows_needed - 1, len(run) - 1
    if last - first < GOLDEN_BATCH * GOLDEN_HORIZON:
        raise DataError(f"{run.path}: {len(run)} rows are too few for golden vectors")
    inputs = np.stack([columns["heater_duty"], columns["fan_on"]], axis=-1)
    ends = first + 1 + GOLDEN_HORIZON * np.arange(GOLDEN_BATCH)
    batch = np.stack([inputs[end : end + GOLDEN_HORIZON] for end in ends])
    starts = np.linspace(first, last - 1, GOLDEN_STEPS).astype(int)
    asked = [(first, inputs[None, first:last]), (first, batch)]
    asked += [(int(now), inputs[None, now : now + 1]) for now in starts]
    return [_golden(predictor, features, columns, now, controls) for now, controls in asked]


def _golden(
    predictor: Predictor, features: Sequence[str], columns: Mapping[str, Any], now: int, controls: Any
) -> dict[str, Any]:
    """Return the rollout of `controls` [B, N, 2] from row `now`."""
    history = {name: values[now + 1 - predictor.rows_needed : now + 1] for name, values in columns.items()}
    ambient = columns["temp_ambient"][now : now + controls.shape[1]]
    temps = predictor.rollout(history, controls, {"temp_ambient": ambient})
    return {
        "window": np.stack([history[name] for name in features], axis=-1).tolist(),
        "ambient": ambient.tolist(),
        "controls": controls.tolist(),
        "temps": np.round(temps, 6).tolist(),
    }


def export_study(folder: Path, path: Path) -> OnnxPredictor:
    """Export what `greenhouse-train` has left in `folder`, with the runs that it was trained on.

    Errors : DataError, also for runs that are not those of the training; OSError
    """
    network, facts = load_network(folder / NETWORK_FILE)
    result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    runs = training_runs(facts["regime"])
    return export(network, study_facts(network, facts, result, runs), runs[0], path)


def study_facts(
    network: Network, facts: Mapping[str, Any], result: Mapping[str, Any], runs: Sequence[RecordedRun]
) -> ExportFacts:
    """Return the facts of a recorded training for `export`; facts of the
    file of weights, result of the record.
    """
    columns = [run.columns for run in split_all(runs).train]
    # The paper's hybrid corrects the bare physics model; ours says which twin it corrects.
    twin = BoxTwin().sha256 if isinstance(network, HamNet) else facts.get("twin_sha256", "")
    return ExportFacts(
        command=facts["command"],
        seed=facts["seed"],
        data_sha256=facts["data_sha256"],
        validity=box_of(columns, contract.keys("ham")),
        metrics={"progress": result["progress"], "scenarios": result["scenarios"]},
        twin_sha256=twin,
    )


def window_rollout(network: WindowNet) -> ModelProto:
    """Return the rollout of any network of a window; it runs the whole window anew in every step.

    window [10, 3], controls [B, N, 2], offset [N] -> temps [B, N], see `edge.models.contract`.
    """
    graph = Graph()
    batch = graph.op("Shape", "controls", start=0, end=1)
    size = graph.op("Concat", batch, graph.integers(WINDOW, len(COLUMNS)), axis=0)
    first = graph.op("Expand", "window", size)
    in_time = graph.op("Transpose", "controls", perm=[1, 0, 2])
    body = _body(graph, single_step(network))
    found = graph.ops("Scan", 2, first, in_time, "offset", num_scan_inputs=2, body=body)[1]  # [N, B]
    graph.give("temps", graph.op("Transpose", found, perm=[1, 0]))
    inputs = [real("window", [WINDOW, len(COLUMNS)]), real("controls", ["B", "N", 2]), real("offset", ["N"])]
    return graph.model("window_rollout", inputs, [real("temps", ["B", "N"])])


def _body(graph: Graph, step: ModelProto) -> GraphProto:
    """Window [B, 10, 3], controls [B, 2] and offset [] of a step -> the next window, its temperature [B].

    The last row's duty and fan are the step's own; in the next window's last row they stand until then.
    """
    inner = Graph(graph)
    last, middle, end = (graph.integers(value) for value in (WINDOW - 1, 1, WINDOW))
    first, rows = graph.integers(0), graph.integers(1)
    columns = graph.integers(2)
    now = inner.op("Slice", "window_now", last, end, rows)  # [B, 1, 3]
    temp = inner.op("Slice", now, first, middle, columns)
    control = inner.op("Unsqueeze", "control_now", rows)
    past = inner.op("Slice", "window_now", first, last, rows)
    filled = inner.op("Concat", past, inner.op("Concat", temp, control, axis=2), axis=1)
    (predicted,) = inner.include(step, {"window": filled})
    following = inner.op("Add", predicted, "offset_now")
    shown = inner.op("Identity", following)
    coming = inner.op("Concat", inner.op("Unsqueeze", following, graph.integers(1, 2)), control, axis=2)
    moved = inner.op("Concat", inner.op("Slice", filled, middle, end, rows), coming, axis=1)
    window: Shape = ("B", WINDOW, len(COLUMNS))
    return inner.body(
        "step",
        [real("window_now", window), real("control_now", ["B", 2]), real("offset_now", [])],
        [real(moved, window), real(shown, ["B"])],
    )


def main(words: Sequence[str] | None = None) -> int:
    """Entry point. Expected errors end in one line and exit code 2."""
    parser = argparse.ArgumentParser(prog="python -m training.export.network_export", description=__doc__)
    parser.add_argument("folder", type=Path, help="where greenhouse-train has left a network")
    parser.add_argument("file", type=Path, help="lstm.onnx or ham.onnx, as it is to be called")
    parser.add_argument("--step", type=Path, help="write a single step too, bare: rigs don't run it")
    arguments = parser.parse_args(words)
    try:
        predictor = export_study(arguments.folder, arguments.file)
        if arguments.step:
            network, _ = load_network(arguments.folder / NETWORK_FILE)
            arguments.step.write_bytes(single_step(network).SerializeToString(deterministic=True))
    except (GreenhouseError, OSError) as error:
        print(f"python -m training.export.network_export: {error}", file=sys.stderr)
        return 2
    print(f"{arguments.file}: {predictor.kind}, version {predictor.version}, golden vectors proved")
    return 0


if __name__ == "__main__":
    sys.exit(main())
