"""`greenhouse-train evaluate`: the comparison of all models, from the recorded runs and the kept weights.

Everything is forecast anew; the errors that a training recorded are not read. Figures go to evaluation.json
and evaluation.txt, which the same machine gives again bit for bit; what is measured with a clock or in memory
goes to cost.json and cost.txt; report.html and the pictures hold both.
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from training.ablation import bases, by_excess, unexplained
from training.datasets import test_run
from training.fit_network import make_deterministic
from training.report import report
from training.report_pictures import MODELS, bars_picture, radar_picture, scenario_picture
from training.report_table import as_text
from training.report_tables import Evaluation, costs_table, tables
from training.resources import Cost, costs
from training.scores import Score, Scored, scored, swapped
from training.study import SCENARIOS
from training.trained import Kept, read_trained, unguarded

COMMAND = "greenhouse-train evaluate"


def run(arguments: argparse.Namespace) -> int:
    """The exit code. Errors: DataError, OSError.

    arguments : trained, results, images (folders), check, tolerance
    """
    make_deterministic(0)
    trainings = read_trained(arguments.trained)
    found = scored([*trainings, *(unguarded(kept) for kept in trainings if kept.model == "ham_guarded")])
    figures = Evaluation(
        tuple(one.score for one in found),
        tuple(unexplained()),
        tuple(bases()),
        tuple(swapped(trainings, "twin")),
        tuple(by_excess(trainings, "twin")),
    )
    print(text_of(figures), end="")
    if arguments.check:
        return _check(figures, found, arguments)
    _write(figures, found, trainings, arguments)
    return 0


def text_of(figures: Evaluation) -> str:
    """The tables of errors."""
    return "\n".join([COMMAND, "", *(line for table in tables(figures) for line in as_text(table))])


def json_of(figures: Evaluation) -> str:
    """All digits, a score on each line."""
    parts = {key: [json.dumps(row) for row in rows] for key, rows in asdict(figures).items()}
    lists = [f"{json.dumps(key)}: [\n" + ",\n".join(rows) + "\n]" for key, rows in parts.items()]
    return "{\n" + ",\n".join(lists) + "\n}\n"


def pictures_of(found: Sequence[Scored], cost: Sequence[Cost]) -> dict[str, bytes]:
    """PNG by file name without its ending."""
    scores: list[Score] = [one.score for one in found]
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


def first_difference(kept: Any, now: Any, tolerance: float = 0.0, place: str = "evaluation.json") -> str:
    """Where two JSON values differ first; "" where no two numbers do by more than `tolerance`."""
    if isinstance(kept, dict) and isinstance(now, dict) and kept.keys() == now.keys():
        parts: Iterator[tuple[Any, Any, Any]] = ((key, kept[key], now[key]) for key in kept)
    elif isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        parts = ((i, a, b) for i, (a, b) in enumerate(zip(kept, now, strict=True)))
    elif _is_number(kept) and _is_number(now):
        return "" if abs(kept - now) <= tolerance else f"{place}: {kept!r} is kept, now {now!r}"
    else:
        return "" if kept == now else f"{place}: {kept!r} is kept, now {now!r}"
    found = (first_difference(a, b, tolerance, f"{place}.{key}") for key, a, b in parts)
    return next((difference for difference in found if difference), "")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _write(
    figures: Evaluation, found: Sequence[Scored], trainings: Sequence[Kept], arguments: argparse.Namespace
) -> None:
    cost = costs(trainings)
    cost_text = "\n".join([COMMAND, "", *as_text(costs_table(cost))])
    print(cost_text)
    files = _files(figures, found, cost, _controllers(arguments.results))
    files["cost.json"] = (json.dumps([asdict(one) for one in cost], indent=1) + "\n").encode()
    files["cost.txt"] = (cost_text + "\n").encode()
    arguments.images.mkdir(parents=True, exist_ok=True)
    arguments.results.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        folder = arguments.images if name.endswith(".png") else arguments.results
        (folder / name).write_bytes(content)


def _controllers(results: Path) -> str:
    """Their part of the report, as `greenhouse-train compare` has left it."""
    path = results / "control" / "section.html"
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _files(
    figures: Evaluation, found: Sequence[Scored], cost: Sequence[Cost], controllers: str
) -> dict[str, bytes]:
    """All that follows from the figures, and from costs that were measured."""
    pictures = pictures_of(found, cost)
    return {
        "evaluation.json": json_of(figures).encode(),
        "evaluation.txt": text_of(figures).encode(),
        "report.html": report(figures, cost, pictures, controllers).encode(),
        **{f"{name}.png": content for name, content in pictures.items()},
    }


def _check(figures: Evaluation, found: Sequence[Scored], arguments: argparse.Namespace) -> int:
    """0 where the kept files come out again; costs are taken as they were kept.

    With a tolerance only the figures are compared: text and pictures differ with their last digit.
    """
    results: Path = arguments.results
    kept = json.loads((results / "evaluation.json").read_text(encoding="utf-8"))
    difference = first_difference(kept, json.loads(json_of(figures)), arguments.tolerance)
    if not difference and not arguments.tolerance:
        cost = [Cost(**row) for row in json.loads((results / "cost.json").read_text(encoding="utf-8"))]
        difference = _first_file(
            _files(figures, found, cost, _controllers(results)), results, arguments.images
        )
    print(difference or "the same as what is kept")
    return 1 if difference else 0


def _first_file(files: Mapping[str, bytes], results: Path, images: Path) -> str:
    for name, content in files.items():
        path = (images if name.endswith(".png") else results) / name
        if path.read_bytes() != content:
            return f"{path}: comes out differently (other versions of matplotlib or its fonts?)"
    return ""
