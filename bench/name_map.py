"""python -m bench.name_map: how sure a name is, learnt from development cases whose truth is known.

A logistic map from the evidence for a name (edge/diagnosis/judge.py) to the probability that it is right.
Names are those in the chosen twins of foreign cases (`python -m bench.foreign make`) and of the measured logs
of bench.real_truth, split dev and scored; a name counts as right where a log can't tell it from a true one.
The evidence is kept line by line, so that a call goes on where the last one ended.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.foreign.score import is_alike
from bench.real_truth.__main__ import is_true, write
from bench.real_truth.logs import LOGS, texts
from edge.core.errors import GreenhouseError
from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.diagnosis.judge import evidence_of, is_name
from edge.diagnosis.runs import read_runs
from edge.twin.twin_file import read_twin_file

Floats = NDArray[np.float64]
COLUMNS = ("intercept", "clearness", "left out", "fitted", "unexplained", "slow")
# Signs that make sense: more evidence makes no name less likely.
LOWEST = np.array([-np.inf, 0.0, 0.0, 0.0, -np.inf, 0.0])
HIGHEST = np.array([np.inf, np.inf, np.inf, np.inf, 0.0, np.inf])
PRIOR_SD = 3.0  # of a slope
SURE = 0.9


def main() -> int:
    """Collect what evidence is missing, and print the map with its scores, each rig judged by the others."""
    parser = argparse.ArgumentParser(prog="python -m bench.name_map", description=__doc__)
    parser.add_argument("evidence", type=Path, help="JSON lines, to go on with")
    parser.add_argument("--foreign", type=Path, help="folder of a split, with cases/ and truth/")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--repositories", type=Path, default=Path("../.mirror"))
    arguments = parser.parse_args()
    lines = arguments.evidence.read_text(encoding="utf-8").splitlines() if arguments.evidence.exists() else []
    known = [json.loads(line) for line in lines]
    done = {item["case"] for item in known}
    for case, rig, is_right, found in _diagnoses(arguments, done):
        item = {"case": case, "rig": rig, "names": _names(found, is_right)}
        known.append(item)
        with arguments.evidence.open("a", encoding="utf-8") as file:
            file.write(json.dumps(item) + "\n")
        print(case, item["names"], file=sys.stderr)
    print(*report(known), sep="\n")
    return 0


def _diagnoses(
    arguments: argparse.Namespace, done: set[str]
) -> Iterator[tuple[str, str, Callable[[str], bool], Diagnosis]]:
    folders = sorted((arguments.foreign / "cases").iterdir()) if arguments.foreign else []
    for folder in folders:
        if folder.name not in done:
            truth = json.loads((arguments.foreign / "truth" / f"{folder.name}.json").read_text())
            yield folder.name, folder.name, partial(_is_hidden, truth["hidden"]), _diagnosis(folder)
    for log in LOGS:
        if log.split == "kept" or not log.main or log.name in done:
            continue
        with TemporaryDirectory() as name:
            try:
                write(log, Path(name), texts(log, arguments.data, arguments.repositories))
                found = _diagnosis(Path(name))
            except GreenhouseError as error:
                print(f"{log.name}: left out: {error}", file=sys.stderr)
                continue
        yield log.name, log.name.partition(",")[0], partial(is_true, log), found


def _is_hidden(hidden: Mapping[str, Any], name: str) -> bool:
    return any(is_alike(name, other) for other in hidden)


def _diagnosis(folder: Path) -> Diagnosis:
    file = read_twin_file(folder / "twin.yaml")
    train, tests = (sorted(folder.glob(f"{role}*.csv")) for role in ("train", "test"))
    return diagnose(file, read_runs(train, tests or train, file), lambda share, text: None, "")


def _names(found: Diagnosis, is_right: Callable[[str], bool]) -> list[dict[str, Any]]:
    """Return the evidence of each name in the chosen twin, and whether it is right."""
    verdict, items = found.verdict, []
    names = frozenset([item.name for item in verdict.effects] + [item.name for item in verdict.doubtful])
    for name in sorted(filter(is_name, names)):
        own = evidence_of(found.choice, names, name)
        items.append({"name": name, "features": own.features, "right": is_right(name)})
    return items


def fit(x: Floats, y: Floats) -> Floats:
    """Return the coefficients of greatest likelihood within their signs. x : [n, 6]; y : [n], 0 or 1"""
    from scipy.optimize import minimize

    def cost(beta: Floats) -> float:
        z = x @ beta
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * np.sum((beta[1:] / PRIOR_SD) ** 2))

    bounds = list(zip(LOWEST, HIGHEST, strict=True))
    return np.asarray(minimize(cost, np.zeros(len(COLUMNS)), bounds=bounds).x, dtype=np.float64)


def report(known: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the map and its scores."""
    rows = [(item["rig"], name) for item in known for name in item["names"]]
    rigs = np.array([rig for rig, _ in rows])
    x = np.array([[1.0, *name["features"]] for _, name in rows])
    y = np.array([float(name["right"]) for _, name in rows])
    chance = np.empty(len(y))
    for rig in np.unique(rigs):
        out = rigs == rig
        chance[out] = 1.0 / (1.0 + np.exp(-x[out] @ fit(x[~out], y[~out])))
    chance = np.clip(chance, 0.01, 0.99)
    base = y.mean()
    yield f"{len(y)} names of {len(known)} cases and {len(np.unique(rigs))} rigs, {y.sum():.0f} of them right"
    yield ", ".join(f"{name} {value:.2f}" for name, value in zip(COLUMNS, fit(x, y), strict=True))
    yield (
        f"log score, each rig by the others: {_log_score(y, chance):.3f}; of the base rate "
        f"{_log_score(y, np.full(len(y), base)):.3f}"
    )
    for least in (SURE, 0.8, 0.5):
        said = chance >= least
        yield f"with {least} or more: {said.sum()}, false {int((said & (y == 0.0)).sum())}"


def _log_score(y: Floats, chance: Floats) -> float:
    return float(-np.mean(y * np.log(chance) + (1.0 - y) * np.log(1.0 - chance)))


if __name__ == "__main__":
    raise SystemExit(main())
