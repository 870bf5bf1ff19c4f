"""python -m bench.foreign make: write cases as a stranger's files; those that are there are kept."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from bench.foreign import cases, greenhouse
from bench.foreign.cases import FIRST_SEEDS, KINDS, ForeignCase, ForeignLog, seed_of
from edge.core.errors import DataError
from edge.core.sweep import add_arguments, sweep

Task = tuple[Path, str, str, int]
ATTEMPTS = 60


def add_place(parser: argparse.ArgumentParser) -> None:
    """Arguments of every command: which cases, and where they and their answers lie."""
    parser.add_argument("--split", choices=list(FIRST_SEEDS), default="dev")
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma between; default: %(default)s")
    parser.add_argument("--per-kind", type=int, help="cases of each kind; default: as many as are scored")
    parser.add_argument("--seed-from", type=int, default=0, metavar="N", help="first number within a kind")
    parser.add_argument("--out", type=Path, default=Path("out/foreign"))
    add_arguments(parser)


def tasks_of(arguments: argparse.Namespace) -> list[Task]:
    """Errors: DataError for a kind that there is not."""
    kinds = arguments.kinds.split(",")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise DataError(f"there is no kind {unknown[0]!r}; there are {', '.join(KINDS)}")
    first = arguments.seed_from
    return [
        (arguments.out / arguments.split, arguments.split, kind, number)
        for kind in kinds
        for number in range(first, first + (arguments.per_kind or KINDS[kind]))
    ]


def name_of(task: Task) -> str:
    """Return the name of a case's folder, which does not reveal the kind."""
    return f"case_{seed_of(*task[1:]):06}"


def main(words: Sequence[str] | None = None) -> int:
    """Make what is missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.foreign make", description=__doc__)
    add_place(parser)
    arguments = parser.parse_args(words)
    tasks = [task for task in tasks_of(arguments) if not _truth_path(task).exists()]
    sweep(_make, tasks, arguments.workers, arguments.dask, lambda done, task, name: print(name, flush=True))
    return 0


def _truth_path(task: Task) -> Path:
    return task[0] / "truth" / f"{name_of(task)}.json"


def _make(task: Task) -> str:
    case = make_case(*task[1:])
    write_case(case, task[0] / "cases" / name_of(task))
    path = _truth_path(task)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(case.truth, indent=1), encoding="utf-8")
    return name_of(task)


def make_case(split: str, kind: str, number: int) -> ForeignCase:
    """Errors: RuntimeError where no draw shows what is hidden."""
    seed = seed_of(split, kind, number)
    rng = np.random.default_rng([7_777, seed])
    attempt = greenhouse.attempt if kind in greenhouse.KINDS else cases.attempt
    for _ in range(ATTEMPTS):
        case = attempt(rng, kind, number)
        if case is not None:
            return replace(case, truth={**case.truth, "seed": seed, "kind": kind, "split": split})
    raise RuntimeError(f"foreign: {split} {kind} {number}: nothing in {ATTEMPTS} draws shows what is hidden")


def write_case(case: ForeignCase, folder: Path) -> None:
    """Write the files that the workflow is given. Errors: OSError"""
    folder.mkdir(parents=True, exist_ok=True)
    for name, log in case.files.items():
        (folder / name).write_text(write_text(name, log), encoding="utf-8")
    text = yaml.safe_dump(dict(case.twin), sort_keys=False)
    (folder / "twin.yaml").write_text(text, encoding="utf-8")


def write_text(name: str, log: ForeignLog) -> str:
    """Return a run file."""
    lines = [f"# role: {name.partition('_')[0]}"]
    if log.judged_from_s is not None:
        lines.append(f"# validate_from_s: {log.judged_from_s:g}")
    lines += [f"# {key}: none" for key in ("fan_on", "temp_ambient_c") if key not in log.columns]
    lines.append(",".join(log.columns))
    for row in zip(*log.columns.values(), strict=True):
        lines.append(",".join(f"{float(value):.10g}" for value in row))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    raise SystemExit(main())
