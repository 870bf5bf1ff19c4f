"""`greenhouse-train tune-networks`: the same few settings for every network, judged on validation parts.

No test run is read. All trials of all networks train with one seed, which the comparison does not use. Trials
on other data or of other networks stay in the file as they are.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from edge.core.errors import DataError
from edge.core.sweep import sweep
from edge.formats.run_file import RecordedRun, data_sha256
from edge.formats.table import Table
from training.data.datasets import Split, training_runs
from training.data.pairs import split_all
from training.evaluate.evaluation import machine_line
from training.evaluate.heated_box import data_hash, parts_with_room, read_data
from training.models.networks import NETWORKS, check_names
from training.models.predictors import WindowPredictor
from training.models.rollout import mean_free_run_mae
from training.models.study import SCENARIOS
from training.models.tuned_settings import (
    ANY_ROOM_C,
    BOX_DATA,
    FILE,
    NetworkTrial,
    best_trial,
    read_trials,
    trial_settings,
)
from training.models.window_network import WindowSettings, train_on

COMMAND = "greenhouse-train tune-networks"
DATA = (*SCENARIOS, BOX_DATA)
DRAWN_BY = 0  # the seed of the settings
TRAINED_BY = 100  # the seed of every training here; the comparison's are 0 to 4


@dataclass(frozen=True, slots=True)
class TuningJob:
    """One trial to be done."""

    network: str
    data: str
    trial: int
    settings: WindowSettings


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError, OSError

    arguments : networks, data (names), trials, kept (train nothing), box, results (folders), workers, dask
    """
    results: Path = arguments.results
    names, data_names = check_names(arguments.networks), arguments.data or DATA
    if arguments.trials < 1:
        raise DataError(f"--trials: {arguments.trials}: at least one, the paper's settings")
    drawn = trial_settings(arguments.trials, DRAWN_BY)
    jobs = [
        TuningJob(network, data, number, settings)
        for data in data_names
        for network in names
        for number, settings in enumerate(drawn)
        if not arguments.kept
    ]
    found = sweep(
        partial(score_trial, arguments.box),
        jobs,
        arguments.workers,
        arguments.dask,
        lambda done, job, one: print(f"{done:3d} of {len(jobs)}  {_line(one)}", flush=True),
    )
    done_now = {(one.network, one.data) for one in found}
    others = [one for one in read_trials(results) if (one.network, one.data) not in done_now]
    every = sorted([*others, *found], key=lambda one: (DATA.index(one.data), one.network, one.trial))
    results.mkdir(parents=True, exist_ok=True)
    rows = [json.dumps(asdict(one)) for one in every]
    (results / FILE).write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")
    printed = (line for table in tables(every) for line in table.text())
    text = "\n".join([COMMAND, machine_line(), "", *printed])
    print(text)
    (results / "tuning.txt").write_text(text + "\n", encoding="utf-8")
    return 0


def score_trial(box: Path, job: TuningJob) -> NetworkTrial:
    """Train one network with one setting and forecast the validation parts."""
    parts, sha256 = tuning_data(job.data, box)
    began = time.perf_counter()
    network, progress = train_on(NETWORKS[job.network], parts, TRAINED_BY, job.settings)
    wall_s = time.perf_counter() - began
    try:
        mae_k = mean_free_run_mae(WindowPredictor(network), parts.validate)
    except DataError:  # the forecast is not finite: the trial is recorded and cannot win
        mae_k = None
    return NetworkTrial(
        job.network,
        job.data,
        job.trial,
        job.settings,
        TRAINED_BY,
        sha256,
        f"{COMMAND} --networks {job.network} --data {job.data}",
        mae_k,
        progress.epochs,
        wall_s,
    )


def tuning_data(data: str, box: Path) -> tuple[Split, str]:
    """Return training and validation parts, and their hash. Errors: DataError where the data are missing"""
    if data == BOX_DATA:
        parts = read_data(box).parts
        return parts_with_room(parts, ANY_ROOM_C), data_hash(parts)
    runs: Sequence[RecordedRun] = training_runs(data)
    return split_all(runs), data_sha256(runs)


def tables(trials: Sequence[NetworkTrial]) -> list[Table]:
    """One table for each of the data: a row per trial, a column per network, and the choices."""
    by_data = {data: [one for one in trials if one.data == data] for data in DATA}
    return [_table(data, found) for data, found in by_data.items() if found]


def _table(data: str, trials: Sequence[NetworkTrial]) -> Table:
    names = [name for name in NETWORKS if any(one.network == name for one in trials)]
    numbers = sorted({one.trial for one in trials})
    heads = ("trial", "rate", "batch", "width", "dropout", "gives", *names)
    rows = []
    for number in numbers:
        mine = {one.network: one for one in trials if one.trial == number}
        settings = next(iter(mine.values())).settings
        rows.append(
            (
                "paper's" if settings == WindowSettings() else str(number),
                f"{settings.learning_rate:g}",
                str(settings.batch_size),
                str(settings.hidden),
                f"{settings.dropout:g}",
                "T+ - T" if settings.predicts_increment else "T+",
                *(_cell(mine.get(name)) for name in names),
            )
        )
    chosen = {name: best_trial(trials, name, data, trials[0].data_sha256).trial for name in names}
    best = ", ".join(f"{name} {number}" for name, number in chosen.items())
    wall_s = sum(one.wall_s for one in trials)
    note = (
        f"Best: {best}. Training took {wall_s:.0f} s in all. "
        f"Seed {TRAINED_BY}, data {trials[0].data_sha256[:12]}."
    )
    return Table(f"{data}: mean free-run MAE over the validation parts [K]", heads, tuple(rows), note)


def _cell(one: NetworkTrial | None) -> str:
    if one is None:
        return "-"
    return "not finite" if one.validation_mae_k is None else f"{one.validation_mae_k:.3f}"


def _line(one: NetworkTrial) -> str:
    what = f"{one.data:14s} {one.network:5s} trial {one.trial:2d}"
    return f"{what}  {_cell(one)} K  {one.epochs:4d} epochs  {one.wall_s:6.1f} s"
