"""`greenhouse-train evaluate`: the comparison of all models, from the recorded runs and the kept weights.

Everything is forecast anew; the errors that a training recorded are not read. Figures go to evaluation.json
and evaluation.txt. The same machine, named in evaluation_machine.json, gives them again bit for bit; another
within ELSEWHERE_K. Times and memory go to cost.json and cost.txt; report.html and the pictures hold both.
"""

import argparse
import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from training.control.compare import kept_section
from training.data.datasets import test_run
from training.evaluate.ablation import bases, by_excess, unexplained_errors
from training.evaluate.difference import differences, first_difference
from training.evaluate.pictures import MODELS, bars_picture, radar_picture, scenario_picture
from training.evaluate.report import Evaluation, costs_table, read_findings, report, tables
from training.evaluate.resources import ModelCost, costs
from training.evaluate.scores import ScoredRun, TrainingScore, score_runs, swap_models
from training.models.fit_network import make_deterministic
from training.models.saved_training import SavedTraining, read_trained, remove_guard, without_weights
from training.models.study import SCENARIOS

COMMAND = "greenhouse-train evaluate"
# Of figures made on another machine [K]. A free run of 203 steps in float32: at most 1.1e-5 was seen.
# The hybrids of `bases` are trained anew, which multiplies last digits: at most 5.8e-3 was seen.
ELSEWHERE_K, ELSEWHERE_TRAINED_K = 1e-3, 0.03
MACHINE_FILE = "evaluation_machine.json"
COMPUTES = ("numpy", "scipy", "torch")  # packages whose arithmetic the figures pass through


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit code. Errors: DataError, OSError

    arguments : trained, results, images (folders), check, tolerance
    """
    make_deterministic(0)
    trainings = read_trained(arguments.trained)
    if not arguments.check and (absent := without_weights(arguments.trained)):
        raise DataError(
            f"{absent[0]}: no weights; `greenhouse-train all` trains this and {len(absent) - 1} more"
        )
    # Each guarded hybrid counts twice: without its guard it shows what the guard is worth.
    found = score_runs(
        [*trainings, *(remove_guard(kept) for kept in trainings if kept.model == "ham_guarded")]
    )
    figures = Evaluation(
        tuple(one.score for one in found),
        tuple(unexplained_errors()),
        tuple(bases()),
        tuple(swap_models(trainings, "twin")),
        tuple(by_excess(trainings, "twin")),
    )
    print(text_of(figures), end="")
    if arguments.check:
        return _check(figures, found, arguments)
    _write(figures, found, trainings, arguments)
    return 0


def text_of(figures: Evaluation) -> str:
    """Return the tables of errors."""
    return "\n".join([COMMAND, "", *(line for table in tables(figures) for line in table.text())])


def json_of(figures: Evaluation) -> str:
    """All digits, a score on each line."""
    parts = {key: [json.dumps(row) for row in rows] for key, rows in asdict(figures).items()}
    lists = [f"{json.dumps(key)}: [\n" + ",\n".join(rows) + "\n]" for key, rows in parts.items()]
    return "{\n" + ",\n".join(lists) + "\n}\n"


def pictures_of(found: Sequence[ScoredRun], cost: Sequence[ModelCost]) -> dict[str, bytes]:
    """PNG by file name without its ending."""
    scores: list[TrainingScore] = [one.score for one in found]
    pictures = {}
    for regime, numbers in SCENARIOS.items():
        for number in numbers:
            forecasts = {
                model: [s.forecast for s in found if s.score.model == model and s.score.scenario == number]
                for model in MODELS
            }
            title = f"Scenario {number} ({regime}): free runs, mean and range of the seeds"
            pictures[f"scenario_{number}"] = scenario_picture(test_run(number), forecasts, title)
        pictures[f"models_{regime}"] = bars_picture(scores, regime)
    pictures["models_radar"] = radar_picture(scores, cost)
    return pictures


def machine() -> dict[str, str]:
    """Facts on which the last digits of a figure depend."""
    cpu = next(
        (
            line.partition(":")[2].strip()
            for line in _cpu_lines()
            if line.startswith(("model name", "CPU part"))
        ),
        platform.processor(),
    )
    versions = {name: importlib.metadata.version(name) for name in COMPUTES}
    return {"cpu": cpu, "architecture": platform.machine(), "python": platform.python_version(), **versions}


def _cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


def _write(
    figures: Evaluation,
    found: Sequence[ScoredRun],
    trainings: Sequence[SavedTraining],
    arguments: argparse.Namespace,
) -> None:
    cost = costs(trainings)
    cost_text = "\n".join([COMMAND, "", *costs_table(cost).text()])
    print(cost_text)
    files = _files(figures, found, cost)
    files["report.html"] = _report(figures, found, cost, arguments)
    files["cost.json"] = (json.dumps([asdict(one) for one in cost], indent=1) + "\n").encode()
    files["cost.txt"] = (cost_text + "\n").encode()
    files[MACHINE_FILE] = (json.dumps(machine(), indent=1) + "\n").encode()
    arguments.images.mkdir(parents=True, exist_ok=True)
    arguments.results.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        folder = arguments.images if name.endswith(".png") else arguments.results
        (folder / name).write_bytes(content)


def _words(results: Path, images: Path) -> tuple[str, str]:
    """Return findings on the models, and the controllers' part of the report."""
    return read_findings(results), kept_section(results / "control", images)


def _files(figures: Evaluation, found: Sequence[ScoredRun], cost: Sequence[ModelCost]) -> dict[str, bytes]:
    """Return the saved files that follow from the figures, and from costs that were measured."""
    pictures = pictures_of(found, cost)
    return {
        "evaluation.json": json_of(figures).encode(),
        "evaluation.txt": text_of(figures).encode(),
        **{f"{name}.png": content for name, content in pictures.items()},
    }


def _report(
    figures: Evaluation, found: Sequence[ScoredRun], cost: Sequence[ModelCost], arguments: argparse.Namespace
) -> bytes:
    """Return the page of all tables and pictures, which is made anew and not saved in the repository."""
    pictures = pictures_of(found, cost)
    return report(figures, cost, pictures, *_words(arguments.results, arguments.images)).encode()


def _check(figures: Evaluation, found: Sequence[ScoredRun], arguments: argparse.Namespace) -> int:
    """Return 0 where the saved files come out again; costs are taken as they were saved.

    Trainings whose weights are not here are left out and counted.

    On the machine that made them every byte must be the same. Elsewhere, or with a tolerance, only figures
    are compared: text and pictures differ with their last digit.
    """
    results: Path = arguments.results
    same = (results / MACHINE_FILE).exists() and _json(results / MACHINE_FILE) == machine()
    kept, now = _json(results / "evaluation.json"), json.loads(json_of(figures))
    absent = without_weights(arguments.trained)
    if absent:
        print(f"{len(absent)} trainings are recorded without their weights: their figures are not checked")
        here = {_training(score) for score in now["scores"]}
        kept["scores"] = [score for score in kept["scores"] if _training(score) in here]
    print("made on this machine" if same else "made on another machine", "[largest difference of each part]")
    found_in = [_part(name, kept.get(name), now[name], _allowance(name, same, arguments)) for name in now]
    difference = next((one for one in found_in if one), "")
    if not difference and same and not arguments.tolerance and not absent:
        cost = [ModelCost(**row) for row in _json(results / "cost.json")]
        difference = _first_file(_files(figures, found, cost), results, arguments.images)
    print(difference or "the same as what is kept")
    return 1 if difference else 0


def _training(score: Mapping[str, Any]) -> tuple[str, str, int]:
    return score["model"], score["regime"], score["seed"]


def _allowance(part: str, same: bool, arguments: argparse.Namespace) -> float:
    if arguments.tolerance is not None:
        return float(arguments.tolerance)
    return 0.0 if same else ELSEWHERE_TRAINED_K if part == "bases" else ELSEWHERE_K


def _part(name: str, kept: Any, now: Any, allowed: float) -> str:
    """Print the largest difference of a part of the figures; its first one that is not allowed."""
    largest = max((amount for amount, _ in differences(kept, now, "")), default=0.0)
    print(f"{name}: {largest:.1e}, allowed {allowed:.1e}")
    return first_difference(kept, now, allowed, f"evaluation.json.{name}")


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _first_file(files: Mapping[str, bytes], results: Path, images: Path) -> str:
    for name, content in files.items():
        path = (images if name.endswith(".png") else results) / name
        if path.read_bytes() != content:
            return f"{path}: comes out differently (other versions of matplotlib or its fonts?)"
    return ""
