"""python -m bench.agreement: whether the diagnosis says the same from other starts, and of halves of a log.

Over cases of `bench.foreign make`. Starts: every value that the twin file leaves to be fitted begins anywhere
within ten times either way, so often; answers agree where their names are the same, and values lie inside
each other's 95 % intervals. Halves: each recording is cut in its middle, and both halves are diagnosed by
themselves; they contradict each other where each is sure of names and none of them is alike.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from bench.foreign.make import Task, add_place, name_of, tasks_of
from bench.foreign.score import SURE, is_alike
from bench.header import header
from bench.hidden_effects.wilson import share
from edge.core.errors import DataError
from edge.core.sweep import sweep
from edge.diagnosis.python import Run, Twin, diagnose
from edge.formats.run_file import cut

Answer = Mapping[str, Any]
FARTHEST = 10.0


def main(words: Sequence[str] | None = None) -> int:
    """Print a line a case and what they come to."""
    parser = argparse.ArgumentParser(prog="python -m bench.agreement", description=__doc__)
    add_place(parser)
    parser.add_argument("--starts", type=int, default=10)
    arguments = parser.parse_args(words)
    print(*header(), sep="\n")
    same, contradict = [], []
    tasks = [(task, arguments.starts) for task in tasks_of(arguments)]
    for _, starts, halves in sweep(_looked_at, tasks, arguments.workers, arguments.dask, _tell):
        same += [starts == "agree"] if starts else []
        contradict += [halves == "contradict each other"] if halves else []
    for what, told in (("from other starts the same", same), ("halves contradict each other", contradict)):
        found = share(told)
        print(
            f"{what:30} {found.value:.2f} [{found.interval[0]:.2f}, {found.interval[1]:.2f}] of {found.cases}"
        )
    return 0


def _tell(done: int, task: object, found: tuple[str, str, str]) -> None:
    name, starts, halves = found
    print(f"{name}: starts {starts or '-'}; halves {halves or '-'}", flush=True)


def _looked_at(given: tuple[Task, int]) -> tuple[str, str, str]:
    task, starts = given
    folder = task[0] / "cases" / name_of(task)
    twin, runs = Twin.read(folder / "twin.yaml"), [Run.read(path) for path in sorted(folder.glob("*.csv"))]
    train = [run for run in runs if run.content.facts["role"] == "train"]
    return name_of(task), _starts(twin, train, starts), _halves(twin, train)


def _starts(twin: Twin, train: Sequence[Run], count: int) -> str:
    """`agree`, what does not, or "" where nothing is to be fitted."""
    if not twin.file.to_fit():
        return ""
    draw = np.random.default_rng(1)
    answers = [diagnose(_begun_anywhere(twin, draw), train).document for _ in range(count)]
    for one, other in combinations(answers, 2):
        if why := disagreement(one, other):
            return why
    return "agree"


def _begun_anywhere(twin: Twin, draw: np.random.Generator) -> Twin:
    values = twin.file.values()
    moved = {}
    for place in twin.file.to_fit():
        allowed = twin.file.scale.possible(twin.file.usual(place))
        start = values[place].value * math.exp(draw.uniform(-1.0, 1.0) * math.log(FARTHEST))
        moved[place] = replace(values[place], value=min(max(start, allowed.low), allowed.high))
    return Twin(twin.file.with_values(moved))


def disagreement(one: Answer, other: Answer) -> str:
    """Names that differ, or a value of one answer outside the other's interval; "" where they agree."""
    names = [sorted(item["name"] for item in found["effects"]) for found in (one, other)]
    if names[0] != names[1]:
        return f"{' + '.join(names[0]) or 'no name'} and {' + '.join(names[1]) or 'no name'}"
    known = [_values(found) for found in (one, other)]
    for key in known[0].keys() & known[1].keys():
        for own, far in (known, known[::-1]):
            low, high = (far[key][end] for end in ("low", "high"))
            if low is not None and high is not None and not low <= own[key]["value"] <= high:
                return f"{key} {own[key]['value']:.3g} is not in {low:.3g} to {high:.3g}"
    return ""


def _values(found: Answer) -> dict[str, Mapping[str, float]]:
    values = dict(found["values"])
    for item in found["effects"]:
        values |= {f"{item['name']}.{key}": value for key, value in item["parameters"].items()}
    return values


def _halves(twin: Twin, train: Sequence[Run]) -> str:
    """Return what both halves are sure of, or that they contradict each other."""
    sure = []
    for first in (True, False):
        parts = [Run(run.name, _half(run, first)) for run in train]
        try:
            found = diagnose(twin, parts).document
        except DataError:
            return ""  # too short to be halved
        sure.append({item["name"] for item in found["effects"] if (item["probability"] or 0.0) >= SURE})
    text = " and ".join(" + ".join(sorted(names)) or "no name" for names in sure)
    if all(sure) and not any(is_alike(one, other) for one in sure[0] for other in sure[1]):
        return "contradict each other"
    return text


def _half(run: Run, first: bool) -> Any:
    facts = {key: fact for key, fact in run.content.facts.items() if key != "validate_from_s"}
    rows = len(run)
    if "validate_from_s" in run.content.facts:
        until_s = float(run.content.facts["validate_from_s"])
        rows = int((run.content.columns["time_s"] < until_s).sum())
    part = cut(run.content, 0, rows // 2) if first else cut(run.content, rows // 2, rows)
    return replace(part, facts=facts)


if __name__ == "__main__":
    raise SystemExit(main())
