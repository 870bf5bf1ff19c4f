"""`greenhouse-train networks`: every network with its tuned settings, beside the other models.

The settings are those that `greenhouse-train tune-networks` chose on validation parts. The figures of the
other models are the committed ones of `greenhouse-train evaluate`.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Columns, Floats
from edge.core.sweep import sweep
from edge.formats.run_file import data_sha256, inside_names
from edge.formats.table import Table
from edge.models.onnx_predictor import OnnxPredictor, open_session
from training.data.datasets import test_run, training_runs
from training.evaluate.evaluation import machine_line
from training.evaluate.heated_box import HORIZONS_S, data_hash, maes, parts_with_room, read_data
from training.export.network_export import export_study
from training.export.window_graph import window_rollout
from training.models.lstm import LstmNet
from training.models.networks import NETWORKS, check_names
from training.models.predictors import WindowPredictor
from training.models.registry import NETWORK_FILE, train_window
from training.models.study import SCENARIOS, Regime, TrainingJob, study
from training.models.summary import Record, best_seed, records, table
from training.models.tuned_settings import ANY_ROOM_C, BOX_DATA, best_trial, read_trials
from training.models.weights import load_network
from training.models.window_network import WINDOW, train_on
from training.reports.report_tables import spread

COMMAND = "greenhouse-train networks"
FILE = "networks.json"
TUNED = "_tuned"
OTHERS = ("linear", "lstm", "lstm_increment", "pbm_fitted", "twin", "ham_guarded")
RIG_REGIME: Regime = "interpolation"  # a rig gets the network that has seen all runs
HORIZON = 20
BATCHES = (1, 42)
TURNS = 40  # the least time of many: other work on the machine only ever adds
_KEPT = ("model", "regime", "seed", "command", "data_sha256", "settings", "progress", "wall_s", "versions")


@dataclass(frozen=True, slots=True)
class NetworkCost:
    """Size of one network as a rig gets it, and its time.

    parameters : trained numbers; onnx_bytes : the whole file with contract and golden vectors
    step_us : CPU time of one step of a rollout of HORIZON steps, for 1 and for 42 sequences together [us]
    """

    model: str
    parameters: int
    onnx_bytes: int
    step_us: tuple[float, ...]


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError, OSError

    arguments : networks (names), seeds, kept (train no network of the regimes), out, trained, box, results
        (folders), workers, dask
    """
    names = check_names(arguments.networks)
    if not arguments.kept:
        jobs = [
            TrainingJob(name + TUNED, regime, seed, f"{COMMAND} --networks {name} --seeds {seed}")
            for name in names
            for regime in SCENARIOS
            for seed in arguments.seeds
        ]
        sweep(
            partial(train_tuned, arguments.results, arguments.out),
            jobs,
            arguments.workers,
            arguments.dask,
            lambda done, job, record: print(f"{done} of {len(jobs)}: {job}", flush=True),
        )
    found = [one for one in records(arguments.out) if str(one["model"]).endswith(TUNED)]
    made = [errors_table(found, arguments.evaluation)]
    if arguments.box.exists():
        made.append(box_table(arguments.box, arguments.results, names, arguments.seeds))
    else:
        print(f"{arguments.box}: no such folder: nothing is forecast on the real box")
    made.append(costs_table(arguments, found))
    text = "\n".join([COMMAND, machine_line(), "", *(line for one in made for line in one.text())])
    print(text)
    rows = [json.dumps({key: one[key] for key in (*_KEPT, "scenarios")}) for one in found]
    (arguments.results / FILE).write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")
    (arguments.results / "networks.txt").write_text(text + "\n", encoding="utf-8")
    return 0


def train_tuned(results: Path, out: Path, job: TrainingJob) -> Record:
    """Train and score one network with the settings that validated best on the regime's runs."""
    name = job.name.removesuffix(TUNED)
    sha256 = data_sha256(training_runs(job.regime))
    settings = best_trial(read_trials(results), name, job.regime, sha256).settings
    return study(job, partial(train_window, NETWORKS[name], settings), out, None)


def errors_table(found: Sequence[Record], evaluation: Path) -> Table:
    """Return the free-run MAE of the tuned networks, below those of other models [K]."""
    every = [*_kept_scores(evaluation), *found]
    there = {one["model"] for one in every}
    names = [name for name in (*OTHERS, *(name + TUNED for name in NETWORKS)) if name in there]
    return table(every, names)


def box_table(box: Path, results: Path, names: Sequence[str], seeds: Sequence[int]) -> Table:
    """Train the networks on the real box with the settings for it; MAE by horizon over its tests [K]."""
    data = read_data(box)
    parts, sha256 = parts_with_room(data.parts, ANY_ROOM_C), data_hash(data.parts)
    trials = read_trials(results)
    rows = []
    for name in names:
        settings = best_trial(trials, name, BOX_DATA, sha256).settings
        found = [
            maes(WindowPredictor(train_on(NETWORKS[name], parts, seed, settings)[0]), data.test, ANY_ROOM_C)
            for seed in seeds
        ]
        rows.append((name + TUNED, *(spread(column) for column in np.stack(found).T)))
    heads = ("real box: MAE [K] at", *(f"{horizon} s" for horizon in HORIZONS_S))
    note = "Forecast and judged as `greenhouse-train heated-box` does, whose table has the other models."
    return Table("", heads, tuple(rows), note)


def _kept_scores(evaluation: Path) -> list[Record]:
    """Return the committed scores of the other models in the shape of records."""
    made: dict[tuple[str, str, int], dict[str, Any]] = {}
    for score in json.loads(evaluation.read_text(encoding="utf-8"))["scores"]:
        key = (score["model"], score["regime"], score["seed"])
        row = made.setdefault(key, {"model": key[0], "regime": key[1], "seed": key[2], "scenarios": {}})
        row["scenarios"][str(score["scenario"])] = {"free_run": score["free_run"]}
    return list(made.values())


def costs_table(arguments: argparse.Namespace, found: Sequence[Record]) -> Table:
    """Measure and return the sizes and times; the paper's LSTM is the unit of time."""
    with tempfile.TemporaryDirectory() as folder:
        cost = _costs(_folders(arguments, found), Path(folder))
    base = cost[0].step_us
    cells = tuple(
        (
            one.model,
            str(one.parameters),
            f"{one.onnx_bytes / 1024:.0f}",
            *(f"{time_us:.0f}" for time_us in one.step_us),
            *(f"{time_us / unit:.2f}" for time_us, unit in zip(one.step_us, base, strict=True)),
        )
        for one in cost
    )
    heads = ("on the rig", "parameters", "ONNX [KiB]", *(f"{b} x {HORIZON} [us/step]" for b in BATCHES))
    heads += tuple(f"ratio, {b}" for b in BATCHES)
    note = (
        "As deployed: the seed that validates best on all runs, through the rig's own loader, one thread. "
        f"Least CPU time of {TURNS} turns in which all take part; ratio: to the LSTM in its own graph."
    )
    return Table("", heads, cells, note)


def _folders(arguments: argparse.Namespace, found: Sequence[Record]) -> dict[str, Path]:
    """Return the folders of the deployed trainings by name, the paper's LSTM first."""
    paper = next(iter(sorted((arguments.trained / "lstm" / RIG_REGIME).glob(f"*/{NETWORK_FILE}"))), None)
    if paper is None:
        raise DataError(f"{arguments.trained / 'lstm' / RIG_REGIME}: no {NETWORK_FILE}")
    folders = {"lstm": paper.parent}
    for name in dict.fromkeys(str(one["model"]) for one in found):
        folders[name] = arguments.out / name / RIG_REGIME / f"seed_{best_seed(found, name, RIG_REGIME)}"
    return folders


def _costs(folders: Mapping[str, Path], scratch: Path) -> list[NetworkCost]:
    predictors: dict[str, OnnxPredictor] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for name, folder in folders.items():
        file = scratch / f"{name}.onnx"
        network, _ = load_network(folder / NETWORK_FILE)
        predictors[name] = export_study(folder, file)
        sizes[name] = sum(part.numel() for part in network.parameters()), file.stat().st_size
        if isinstance(network, LstmNet):
            # The same LSTM without its own graph: what is the network's cost and what is the graph's.
            content = window_rollout(network).SerializeToString(deterministic=True)
            general = f"{name}, general graph"
            predictors[general] = OnnxPredictor("", "", predictors[name].contract, open_session(content))
            predictors[general].prove()
            sizes[general] = sizes[name][0], len(content)
    times = [step_times(predictors, batch) for batch in BATCHES]
    return [NetworkCost(name, *size, tuple(one[name] for one in times)) for name, size in sizes.items()]


def step_times(predictors: Mapping[str, OnnxPredictor], batch: int) -> dict[str, float]:
    """Return the least CPU time of one step of each [us]; they take turns."""
    history, controls = _question(batch)
    least = dict.fromkeys(predictors, np.inf)
    for _ in range(TURNS):
        for name, predictor in predictors.items():
            began = time.thread_time()
            predictor.rollout(history, controls, {})
            least[name] = min(least[name], time.thread_time() - began)
    return {name: 1e6 * seconds / HORIZON for name, seconds in least.items()}


def _question(batch: int) -> tuple[Columns, Floats]:
    """Return the first rows of a test run, and its next inputs for every sequence."""
    columns = inside_names(test_run(1))
    history = {name: values[:WINDOW] for name, values in columns.items()}
    ahead = np.stack([columns[name][WINDOW - 1 : WINDOW - 1 + HORIZON] for name in ("heater_duty", "fan_on")])
    return history, np.repeat(ahead.T[None], batch, axis=0)
