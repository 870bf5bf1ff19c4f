"""python -m bench.hidden_effects make: write cases of a suite and split; those that are there are kept."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bench.hidden_effects.case_files import folders, is_made, write_case
from bench.hidden_effects.cases import FIRST_SEEDS, KINDS, SUITES, case_id, seed_of
from edge.core import sweep


class MakeTask(NamedTuple):
    """One case to be made."""

    root: Path
    suite: str
    split: str
    kind: str
    number: int

    @property
    def id(self) -> str:
        """Folder name of the case, which also gives its seed."""
        return case_id(seed_of(self.split, self.kind, self.number))


def main(words: Sequence[str] | None = None) -> int:
    """Make what is missing and say what is there."""
    parser = argparse.ArgumentParser(prog="python -m bench.hidden_effects make", description=__doc__)
    add_arguments(parser)
    return make(parser.parse_args(words))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of `make`."""
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--split", choices=list(FIRST_SEEDS), default="dev")
    parser.add_argument("--out", type=Path, default=Path("out/hidden"))
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma between; default: %(default)s")
    parser.add_argument("--per-kind", type=int, help="cases of each kind; default: as many as are scored")
    parser.add_argument("--seed-from", type=int, default=0, metavar="N", help="first number within a kind")
    sweep.add_arguments(parser, workers=1)


def make(arguments: argparse.Namespace) -> int:
    """Make the cases of parsed arguments; the exit code."""
    kinds = arguments.kinds.split(",")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        print(f"there is no kind {unknown[0]!r}; there are {', '.join(KINDS)}")
        return 2
    tasks = [
        MakeTask(arguments.out, arguments.suite, arguments.split, kind, arguments.seed_from + number)
        for kind in kinds
        for number in range(arguments.per_kind or KINDS[kind])
    ]
    missing = [task for task in tasks if not is_made(task.root, task.suite, task.split, task.id)]
    print(f"{len(tasks)} cases, {len(tasks) - len(missing)} of them there", flush=True)
    made = _make_all(missing, arguments.workers, arguments.dask)
    given, _ = folders(arguments.out, arguments.suite, arguments.split)
    print(f"in {given}")
    return 0 if made else 1


def _make_all(tasks: Sequence[MakeTask], workers: int, dask: str | None) -> bool:
    """Make all cases; return whether each could be made."""
    made = sweep.sweep(_make_one, tasks, workers, dask, lambda done, task, found: print(found[1], flush=True))
    return all(is_there for is_there, _ in made)


def _make_one(task: MakeTask) -> tuple[bool, str]:
    """Make and write a case; whether it could be, and a line that says so without telling what is hidden."""
    begun = time.perf_counter()
    if task.suite == "equations":
        from bench.hidden_effects.equations_cases import make_case
    else:
        from bench.hidden_effects.chamber_cases import make_case
    try:
        write_case(make_case(task.split, task.kind, task.number), task.root)
    except RuntimeError as error:  # no box came out as wanted
        return False, str(error)
    return True, f"{task.id} {task.kind} {time.perf_counter() - begun:.1f} s"


if __name__ == "__main__":
    raise SystemExit(main())
