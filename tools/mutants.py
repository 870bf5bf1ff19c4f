"""python -m tools.mutants draw | run FILE: do the tests notice small changes of the code?

`draw` writes a sample of cosmic-ray's work list over the rooms that safety hangs on: an equal part by each
seed, spread over the rooms by their lines. `run` makes one change at a time in a copy of the tree. It runs
the nearest tests first, then all tests of the room. A mutant is found again by its changed lines, so FILE
also serves later versions of the code. A mutant whose lines are no longer there is reported as gone. For a
survivor that changes no answer, FILE has the reason (`answers_alike`).
"""

import argparse
import contextlib
import itertools
import json
import os
import random
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_and_test, mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import TestOutcome, run_tests
from cosmic_ray.work_item import MutationSpec

ROOT = Path(__file__).parent.parent
ROOMS = {  # room of edge -> folders of tests, nearest first
    "safety": ("tests/edge/safety",),
    "tick": ("tests/edge/tick",),
    "board": ("tests/edge/board",),
    "storage": ("tests/edge/storage",),
    "bundle": ("tests/edge/bundle",),
    "mqtt": ("tests/edge/mqtt",),
    "formats": ("tests/edge/formats", "tests/edge/config"),
}
# cosmic-ray replaces each operator by each other one. Most of these mutants fail at once (`|` of an
# annotation, `is` for `<`) and would drown the others.
KEPT = re.compile(
    r"(Number|Exception)Replacer|AddNot|ReplaceOrWithAnd|ReplaceAndWithOr|ReplaceTrueWithFalse|ReplaceFalseWithTrue"
    r"|ZeroIterationForLoop|ReplaceBreakWithContinue|ReplaceContinueWithBreak|USub_UAdd|Delete_Not"
    r"|Operator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Lt_LtE|LtE_Lt|Gt_GtE|GtE_Gt|Lt_GtE|GtE_Lt|Gt_LtE|LtE_Gt"
    r"|Eq_NotEq|NotEq_Eq|Is_IsNot|IsNot_Is)$"
)
LIMIT_S = 900.0  # of the tests of one room, on a busy machine
UNCOPIED = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__", ".*_cache")
Mutant = dict[str, Any]


def specs(tree: Path, module: str) -> list[MutationSpec]:
    """Return every mutant of a module that may be drawn; `module` is a path from `tree`."""
    items = (item.mutations[0] for item in _all_work_items([tree / module], {}))
    return [spec for spec in items if KEPT.search(spec.operator_name)]


def shown(tree: Path, spec: MutationSpec) -> Mutant | None:
    """Return a mutant with its changed lines, or None where cosmic-ray fails at it, as at `except a.B:`."""
    source = spec.module_path.read_text()
    with contextlib.suppress(AttributeError):
        changed = mutate_code(source, get_operator(spec.operator_name)(), spec.occurrence)
        if changed is not None and changed != source:
            before, after = _changed_lines(source, changed)
            return {"module": str(spec.module_path.relative_to(tree)), "line": spec.start_pos[0],
                    "within": spec.definition_name, "operator": spec.operator_name,
                    "occurrence": spec.occurrence, "before": before, "after": after}  # fmt: skip
    return None


def _changed_lines(before: str, after: str) -> tuple[str, str]:
    old, new = before.splitlines(), after.splitlines()
    first = next((k for k, pair in enumerate(zip(old, new, strict=False)) if pair[0] != pair[1]), 0)
    shortest = min(len(old), len(new)) - first
    last = next((k for k in range(shortest) if old[-k - 1] != new[-k - 1]), shortest)
    return "\n".join(old[first : len(old) - last]), "\n".join(new[first : len(new) - last])


def draw(tree: Path, count: int, seeds: Sequence[int]) -> list[Mutant]:
    """Draw `count` different mutants, an equal part by each seed, spread over the rooms by lines."""
    lines = {room: sum(len(path.read_text().splitlines()) for path in _modules(tree, room)) for room in ROOMS}
    drawn: list[Mutant] = []
    for seed in seeds:
        chance = random.Random(seed)
        wanted = Counter(chance.choices(list(ROOMS), list(lines.values()), k=count // len(seeds)))
        for room in ROOMS:
            every = [
                spec for path in _modules(tree, room) for spec in specs(tree, str(path.relative_to(tree)))
            ]
            order = (shown(tree, spec) for spec in chance.sample(every, len(every)))
            new = (mutant for mutant in order if mutant and mutant not in drawn)
            drawn += list(itertools.islice(new, wanted[room]))
    return drawn


def _modules(tree: Path, room: str) -> list[Path]:
    return sorted(path for path in (tree / "edge" / room).rglob("*.py") if path.name != "__init__.py")


def find(tree: Path, mutant: Mutant) -> Mutant | None:
    """Return the mutant as it is in `tree`, perhaps in another module of its room, or None."""
    first, room = tree / mutant["module"], mutant["module"].split("/")[1]
    paths = sorted(_modules(tree, room), key=lambda path: path != first)
    return next((found for path in paths if (found := _find_in(tree, path, mutant))), None)


def _find_in(tree: Path, path: Path, mutant: Mutant) -> Mutant | None:
    text = path.read_text()
    if mutant["before"] not in text:
        return None
    lines = text.splitlines()
    likely = [
        spec
        for spec in specs(tree, str(path.relative_to(tree)))
        if spec.operator_name == mutant["operator"] and lines[spec.start_pos[0] - 1] in mutant["before"]
    ]
    likely.sort(key=lambda spec: abs(spec.start_pos[0] - mutant["line"]))
    return next((m for spec in likely if (m := shown(tree, spec)) and _change(m) == _change(mutant)), None)


def _change(mutant: Mutant) -> tuple[str | None, str, str]:
    return mutant["within"], mutant["before"], mutant["after"]


def _work_in_a_copy(tree: str) -> None:
    place = Path(tempfile.mkdtemp(prefix="mutants-", dir=os.environ["MUTANTS_PLACE"])) / "tree"
    shutil.copytree(tree, place, ignore=UNCOPIED, symlinks=True)
    os.chdir(place)
    os.environ["PYTHONPATH"], os.environ["CI"] = str(place), "1"


def judge(mutant: Mutant) -> str:
    """Return what the tests make of a mutant: noticed, survived or gone. Works in the current folder."""
    if (here := find(Path(), mutant)) is None:
        return "gone"
    spec = MutationSpec(Path(here["module"]), here["operator"], here["occurrence"], (1, 0), (2, 0))
    room = here["module"].split("/")[1]
    for tests in _stages(Path(here["module"]), room):
        result = mutate_and_test([spec], _command(tests), LIMIT_S)
        if result.test_outcome != TestOutcome.SURVIVED:
            return "noticed"
    return "survived"


def _stages(module: Path, room: str) -> list[Sequence[str]]:
    name = re.compile(rf"\b{module.stem}\b")
    nearest = [
        path for path in sorted(Path(ROOMS[room][0]).rglob("test_*.py")) if name.search(path.read_text())
    ]
    nearest.sort(key=lambda path: path.stem != f"test_{module.stem}")
    return [[str(path) for path in nearest], ROOMS[room]] if nearest else [ROOMS[room]]


def _command(tests: Sequence[str]) -> str:
    python = f"{sys.executable} -m pytest -x -q --no-header -p no:cacheprovider"
    return " ".join([python, *tests])


def _unchanged(room: str) -> tuple[str, str]:
    outcome, output = run_tests(_command(ROOMS[room]), LIMIT_S)
    return ("" if outcome == TestOutcome.SURVIVED else room), output


def run(tree: Path, file: Path, jobs: int) -> int:
    """Judge the mutants of a file, print the table, and write each outcome into the file."""
    drawn: list[Mutant] = json.loads(file.read_text())
    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        os.environ["MUTANTS_PLACE"] = place
        with ProcessPoolExecutor(jobs, initializer=_work_in_a_copy, initargs=(str(tree),)) as pool:
            for failing, output in pool.map(_unchanged, ROOMS):
                if failing:
                    print(
                        f"the tests of edge/{failing} fail without a change:\n{output[-2000:]}",
                        file=sys.stderr,
                    )
                    return 1
            for mutant, outcome in zip(drawn, pool.map(judge, drawn), strict=True):
                mutant["outcome"] = outcome
                if outcome != "noticed":
                    where = f"{mutant['module']}:{mutant['line']} {mutant['operator']}"
                    why = mutant.get("answers_alike", "")
                    print(
                        f"{outcome}: {where}\n  - {mutant['before']}\n  + {mutant['after']}\n  {why}",
                        flush=True,
                    )
    _write(file, drawn)
    print("\n".join(_table(drawn)))
    return 0


def _write(file: Path, drawn: Sequence[Mutant]) -> None:
    file.write_text("[\n" + ",\n".join(json.dumps(mutant) for mutant in drawn) + "\n]\n")


def _table(drawn: Sequence[Mutant]) -> Iterator[str]:
    yield f"{'room':10}{'mutants':>9}{'noticed':>9}{'survived':>10}{'alike':>7}{'gone':>6}"
    for room in (*ROOMS, "all"):
        of_room = [m for m in drawn if room in ("all", m["module"].split("/")[1])]
        counts = Counter(
            "alike" if m["outcome"] == "survived" and m.get("answers_alike") else m["outcome"]
            for m in of_room
        )
        columns = f"{counts['noticed']:9}{counts['survived']:10}{counts['alike']:7}{counts['gone']:6}"
        yield f"{room:10}{len(of_room):9}{columns}"


def main() -> int:
    """Draw or run. Exit code 1 where the tests fail without any change."""
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=__doc__)
    parser.add_argument("verb", choices=("draw", "run"))
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout to mutate a copy of")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seeds", type=int, nargs="+", default=(1, 2))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    if arguments.verb == "run":
        return run(arguments.tree.resolve(), arguments.file, arguments.jobs)
    drawn = draw(arguments.tree.resolve(), arguments.count, arguments.seeds)
    _write(arguments.file, drawn)
    return 0


if __name__ == "__main__":
    sys.exit(main())
