"""python -m bench.hidden_effects score: answers held against truths, from files to files.

Classes are cached under <results>/<suite>/<split>/classes/; the score of every case stands in score.json, the
tables in score.txt and score.md.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.hidden_effects.run_cases import SOLVERS, case_sha256
from bench.hidden_effects.score import document, write_document
from bench.hidden_effects.score_aliases import AliasClass, cached_classes
from bench.hidden_effects.score_case import (
    CasePaths,
    DiagnosisAnswer,
    ScoredCase,
    add_place,
    cases_of,
    read_answer,
    read_truth,
    score,
)
from bench.hidden_effects.table import markdown, text
from edge.core.errors import DataError
from edge.core.sweep import add_arguments, sweep
from edge.formats.run_file import read_run
from edge.twin.twin_file import read_twin_file


def main(words: Sequence[str] | None = None) -> int:
    """Score every solver that has answered; the tables on standard output."""
    parser = argparse.ArgumentParser(prog="python -m bench.hidden_effects score", description=__doc__)
    add_place(parser)
    add_arguments(parser)
    arguments = parser.parse_args(words)
    results = arguments.results / arguments.suite / arguments.split
    cases = cases_of(arguments)
    classes = _all_classes(cases, results, arguments.workers, arguments.dask)
    solvers = {
        name: [
            _score(truth, classes[folder.name], took, results / name / folder.name)
            for folder, truth in cases
            if (took := _took(results / name / folder.name / "run.json", folder))
        ]
        for name in SOLVERS
    }
    # A solver that has not run is left out, not scored as wrong.
    solvers = {name: scored for name, scored in solvers.items() if scored}
    if not solvers:
        raise DataError(f"{results}: no answer to these cases: run them first")
    content = document(solvers, {"suite": arguments.suite, "split": arguments.split, "cases": len(cases)})
    write_document(results / "score.json", content)
    (results / "score.txt").write_text(text(content), encoding="utf-8")
    (results / "score.md").write_text(markdown(content), encoding="utf-8")
    print(text(content))
    return 0


def classes_of(paths: tuple[Path, Path, Path]) -> tuple[AliasClass, ...]:
    """Return the alias classes of a case, computed once for its files and its truth: folder, truth, cache."""
    folder, truth, cache = paths
    key = f"{case_sha256(folder)}:{read_truth(truth).hidden}"
    runs = [read_run(path) for path in sorted(folder.glob("train_*.csv"))]
    return cached_classes(cache, key, read_truth(truth), read_twin_file(folder / "twin.yaml"), runs)


def _all_classes(
    cases: Sequence[CasePaths], results: Path, workers: int, dask: str | None
) -> dict[str, tuple[AliasClass, ...]]:
    def tell(done: int, job: object, found: object) -> None:
        print(f"alias classes: {done} of {len(cases)}", end="\r", file=sys.stderr, flush=True)

    jobs = [(folder, truth, results / "classes" / f"{folder.name}.json") for folder, truth in cases]
    found = sweep(classes_of, jobs, workers, dask, tell)
    print(file=sys.stderr)
    return {folder.name: own for (folder, _), own in zip(cases, found, strict=True)}


def _score(truth: Path, classes: Sequence[AliasClass], took: Mapping[str, Any], place: Path) -> ScoredCase:
    """Score the answer in a place. A failed run has no answer, whatever lies there."""
    given: DiagnosisAnswer | None = None
    if took["exit"] == 0:
        try:
            given = read_answer(place / "diagnosis.json")
        except DataError as error:
            print(error)
    return score(read_truth(truth), classes, given, float(took["wall_s"]), float(took["cpu_s"]))


def _took(path: Path, folder: Path) -> dict[str, Any]:
    """Read run.json; empty for a case that was not run, or with other files: it is left out."""
    if not path.exists():
        return {}
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found if found["case_sha256"] == case_sha256(folder) else {}
