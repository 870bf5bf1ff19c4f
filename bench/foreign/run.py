"""python -m bench.foreign run: `greenhouse twin diagnose` on every case."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from bench.foreign.make import add_place, name_of, tasks_of
from bench.hidden_effects.run_cases import LIMIT_S, OURS, SolverTask, is_done, run_all


def main(words: Sequence[str] | None = None) -> int:
    """Run what has no answer of its present files yet."""
    parser = argparse.ArgumentParser(prog="python -m bench.foreign run", description=__doc__)
    add_place(parser)
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="of one case; default: %(default)g")
    parser.add_argument("--again", action="store_true", help="also what has an answer")
    arguments = parser.parse_args(words)
    wanted = []
    for task in tasks_of(arguments):
        folder = task[0] / "cases" / name_of(task)
        wanted.append(SolverTask(OURS, folder, answer_of(task[0], name_of(task)), arguments.limit_s))
    missing = [task for task in wanted if arguments.again or not is_done(task)]
    run_all(missing, arguments.workers, arguments.dask)
    return 0


def answer_of(root: Path, name: str) -> Path:
    """Folder of a case's answer."""
    return root / "answers" / name
