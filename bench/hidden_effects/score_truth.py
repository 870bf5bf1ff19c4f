"""Which cases are meant, and their truths, read back by the scorer alone."""

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

from bench.hidden_effects.cases import (
    FIRST_SEEDS,
    GENERATOR_VERSION,
    KINDS,
    SUITES,
    HiddenEffect,
    RunTruth,
    Truth,
)
from edge.core.errors import DataError


def read_truth(path: Path) -> Truth:
    """Read the truth of a case. Errors: DataError naming the file, if it is invalid or of another version"""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        truth = _truth(document)
    except (OSError, json.JSONDecodeError, TypeError, KeyError) as error:
        raise DataError(f"{path}: no truth of a case: {error!r}") from error
    if truth.generator_version != GENERATOR_VERSION:
        raise DataError(f"{path}: of generator version {truth.generator_version}: make the cases anew")
    return truth


def _truth(document: dict[str, Any]) -> Truth:
    outside = document["outside"]
    return Truth(
        **{
            **document,
            "hidden": tuple(HiddenEffect(**item) for item in document["hidden"]),
            "outside": None if outside is None else HiddenEffect(**outside),
            "depends_on": tuple(document["depends_on"]),
            "known": tuple(document["known"]),
            "tests": {name: RunTruth(**item) for name, item in document["tests"].items()},
        }
    )


class CasePaths(NamedTuple):
    """A case's folder, and the file of its truth."""

    folder: Path
    truth: Path


def add_place(parser: argparse.ArgumentParser) -> None:
    """Arguments of `run`, `score` and `table`: where cases and answers lie, and which."""
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--split", choices=list(FIRST_SEEDS), default="dev")
    parser.add_argument("--root", type=Path, default=Path("out/hidden"), help="of the cases")
    parser.add_argument("--results", type=Path, default=Path("out/hidden_results"))
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma between; default: %(default)s")
    parser.add_argument("--per-kind", type=int, help="first cases of each kind; default: all that are there")


def cases_of(arguments: argparse.Namespace) -> list[CasePaths]:
    """Return the cases that the arguments mean, in order. Errors: DataError where there are none"""
    place = arguments.root / arguments.suite / arguments.split
    kinds, found = dict.fromkeys(arguments.kinds.split(","), 0), []
    for path in sorted((place / "truth").glob("case_*.json")):
        kind = read_truth(path).kind
        if kind not in kinds or kinds[kind] == arguments.per_kind:
            continue
        kinds[kind] += 1
        found.append(CasePaths(place / "cases" / path.stem, path))
    if not found:
        raise DataError(f"{place}: no case of {arguments.kinds}: make them first")
    return found
