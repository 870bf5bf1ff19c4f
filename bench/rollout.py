"""python -m bench.rollout: forecasts of candidate sequences, one ONNX graph beside other ways to get them.

`one graph` is what the rig runs: `rollout` of the predictor read from its file. `steps` is a Python loop of a
graph of one step, `torch` the network in eager mode. CPU times of one thread, the least of many turns that
the ways take one after the other. Weights are drawn, not trained: the time does not depend on them. The
guarded hybrid first finds its hidden states from the last ten rows, except in `steps`, which is given them.
"""

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: CPU time is of one thread

import numpy as np
import onnxruntime
import torch

from edge.core.predictor import Columns, Floats, Predictor
from edge.formats.run_file import RecordedRun, inside_names
from edge.models.arx_file import read_arx
from edge.models.contract import keys
from edge.models.pbm import Pbm
from edge.models.validity import box_of
from edge.twin.effects.library import EFFECTS
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from training.data.datasets import training_runs
from training.export.network_export import ExportFacts, export
from training.export.onnx_step import single_step
from training.models.ham import STEP_S, HamNet
from training.models.ham_guarded import GuardedHamNet
from training.models.lstm import LstmNet
from training.models.pbm import FITTED
from training.models.predictors import Network, eager
from training.models.twin_step import TwinStep
from training.models.window_network import WINDOW, WindowNet

BATCHES = (1, 42, 2000)
HORIZON = 20
Way = Callable[[Floats], Floats]  # controls [B, N, 2] -> temperatures [B, N]


def networks() -> dict[str, Network]:
    """Return the networks of the paper and the guarded hybrid, sized as they are trained."""
    torch.manual_seed(0)
    mean, scale = torch.tensor([28.0, 22.0, 50.0, 0.009]), torch.tensor([4.0, 1.0, 30.0, 0.009])
    effects = {name: {item.name: item.start for item in EFFECTS[name].parameters} for name in FITTED.effects}
    guarded = GuardedHamNet(TwinStep.of(BoxTwin(effects=effects)))
    guarded.low.copy_(torch.tensor([20.0, 18.0, 0.0, 0.0]))
    guarded.high.copy_(torch.tensor([40.0, 26.0, 1.0, 1.0]))
    guarded.mean.copy_(torch.tensor([28.0, 22.0, 0.5, 0.5]))
    return {
        "LSTM": LstmNet(torch.tensor([28.0, 0.5, 0.5]), torch.tensor([4.0, 0.3, 0.5]), 28.0, 4.0).eval(),
        "HAM (paper)": HamNet(Geometry(), STEP_S, mean, scale, -0.02, 0.02).eval(),
        "HAM (guarded)": guarded.eval(),
    }


def past_and_coming(run: RecordedRun) -> tuple[Columns, Columns]:
    """Return the first rows of a run as history, and the room temperature of the coming steps."""
    columns = inside_names(run)
    history = {name: values[:WINDOW] for name, values in columns.items()}
    return history, {"temp_ambient": columns["temp_ambient"][WINDOW - 1 : WINDOW - 1 + HORIZON]}


def ways(network: Network, run: RecordedRun, folder: Path) -> dict[str, Way]:
    """Return the three ways of one network, from the same rows of `run`."""
    history, ahead = past_and_coming(run)
    facts = ExportFacts("bench", 0, "", box_of([run.columns], keys("ham")), {}, _twin_sha256(network))
    graph = export(network, facts, run, folder / "model.onnx")
    if isinstance(network, WindowNet):
        stepped = _lstm_steps(network, history, ahead)
    else:
        stepped = _ham_steps(network, history, ahead)
    return {
        "one graph": _call(graph, history, ahead),
        "steps": stepped,
        "torch": _call(eager(network), history, ahead),
    }


def _twin_sha256(network: Network) -> str:
    return "" if isinstance(network, WindowNet) else "bench"


def _call(predictor: Predictor, history: Columns, ahead: Columns) -> Way:
    return lambda controls: predictor.rollout(history, controls, ahead)


def _step_session(network: Network) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(single_step(network).SerializeToString(), options)


def _lstm_steps(network: WindowNet, history: Columns, ahead: Columns) -> Way:
    session = _step_session(network)
    start = np.stack([history[name] for name in ("temp_air", "heater_duty", "fan_on")], axis=-1)

    def way(controls: Floats) -> Floats:
        inputs = controls.astype(np.float32)
        window = np.repeat(start[None].astype(np.float32), len(inputs), axis=0)
        temps = []
        for k in range(inputs.shape[1]):
            window[:, -1, 1:] = inputs[:, k]
            temps.append(session.run(None, {"window": window})[0])
            window[:, :-1] = window[:, 1:]
            window[:, -1, 0] = temps[-1]
        return np.stack(temps, axis=1)

    return way


@torch.no_grad()
def _ham_steps(network: HamNet | GuardedHamNet, history: Columns, ahead: Columns) -> Way:
    session = _step_session(network)
    past = [
        torch.from_numpy(history[name][None]).float()
        for name in ("temp_air", "temp_ambient", "heater_duty", "fan_on")
    ]
    start = network.start(*past) if isinstance(network, GuardedHamNet) else past[0][:, -1:]
    ambient = ahead["temp_ambient"].astype(np.float32)

    def way(controls: Floats) -> Floats:
        inputs = controls.astype(np.float32)
        state = start.repeat(len(inputs), 1).numpy()
        temps = []
        for k in range(inputs.shape[1]):
            room = np.full(len(inputs), ambient[k])
            feed = {"state": state, "ambient": room, "duty": inputs[:, k, 0], "fan": inputs[:, k, 1]}
            (state,) = session.run(None, feed)
            temps.append(state[:, 0])
        return np.stack(temps, axis=1)

    return way


def least_ms(found: dict[str, Way], controls: Floats, seconds: float) -> dict[str, float]:
    """Least CPU time of a rollout of each way [ms]; they take turns for `seconds`, three at least."""
    times: dict[str, list[float]] = {name: [] for name in found}
    answers = [way(controls) for way in found.values()]  # imports and caches are not part of the time
    if not all(np.allclose(answer, answers[0], atol=1e-3) for answer in answers):
        raise SystemExit("bench.rollout: the ways differ")
    end = time.monotonic() + seconds
    while time.monotonic() < end or len(times["one graph"]) < 3:
        for name, way in found.items():
            begun = time.process_time()
            way(controls)
            times[name].append(1e3 * (time.process_time() - begun))
    return {name: min(taken) for name, taken in times.items()}


def draw(batch: int) -> Floats:
    """Random inputs [batch, HORIZON, 2]."""
    generator = np.random.default_rng(batch)
    duty = generator.integers(0, 21, (batch, HORIZON)) / 20.0
    return np.stack([duty, generator.integers(0, 2, (batch, HORIZON)).astype(float)], axis=-1)


def print_table(models: dict[str, dict[str, Way]], seconds: float) -> None:
    """One row per model and number of sequences."""
    heads = ("sequences", "one graph", "steps", "torch", "steps/graph", "torch/graph")
    print(" " * 14 + "".join(f"{head:>12}" for head in heads))
    for name, found in models.items():
        for batch in BATCHES:
            ms = least_ms(found, draw(batch), seconds)
            others = [ms.get(way) for way in ("steps", "torch")]
            cells = [f"{batch}", f"{ms['one graph']:.2f}"]
            cells += ["" if other is None else f"{other:.2f}" for other in others]
            cells += ["" if other is None else f"{other / ms['one graph']:.1f}" for other in others]
            print(f"{name:14}" + "".join(f"{cell:>12}" for cell in cells), flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.rollout", description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each row")
    options = parser.parse_args()
    torch.set_num_threads(1)
    run = training_runs("interpolation")[0]
    history, ahead = past_and_coming(run)
    print(__doc__.splitlines()[0])
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "onnxruntime", "torch"))
    print(f"python {platform.python_version()}, {packages}; {platform.machine()}")
    print(f"rollouts of {HORIZON} steps, [ms]; ARX and PBM are numpy\n")
    with tempfile.TemporaryDirectory() as folder:
        models = {name: ways(network, run, Path(folder)) for name, network in networks().items()}
    for name, predictor in (("ARX", read_arx()), ("PBM", Pbm())):
        models[name] = {"one graph": _call(predictor, history, ahead)}
    print_table(models, options.seconds)


if __name__ == "__main__":
    main()
