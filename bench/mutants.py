"""python -m bench mutants [PACKAGE ...]: random small changes of a package, and those that no test notices.

`changes` gives the operators of mutation testing for one place of a program. It draws some by a seed and
makes one at a time in a temporary copy of the tree. There it runs the tests that import the package, first
those that import the changed module. A change that no test notices is printed with its place and its
difference. A change without any effect counts as a survivor.
"""

import argparse
import ast
import copy
import difflib
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
OPPOSITE = {"min": "max", "max": "min"}
IN_PROCESS = "mutation"  # tests that import it change the sources themselves
SLOWER = 3.0  # a mutant's tests may take this many times as long as the tests without a change
LEAST_LIMIT_S = 60.0
NOTICED, TIMED_OUT, SURVIVED = "noticed", "timed out", "survived"


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield each way to change one operator or value of `node`: its kind and the changed node."""
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    ops = [other() if k == index else op for k, op in enumerate(node.ops)]
                    yield "comparison", _with(node, ops=ops)
        case ast.BoolOp():
            yield "boolean", _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
        case ast.BinOp() if type(node.op) in ARITHMETIC:
            yield "arithmetic", _with(node, op=ARITHMETIC[type(node.op)]())
        case ast.UnaryOp(op=ast.Not()):
            yield "boolean", node.operand
        case ast.IfExp():
            yield "boolean", _with(node, body=node.orelse, orelse=node.body)
        case ast.Call(func=ast.Name(id="min" | "max")):
            yield from (("min/max", other) for other in _other_extremes(node))
        case ast.Constant() | ast.Return():
            yield from (("constant", other) for other in _other_values(node))


def _other_extremes(call: ast.Call) -> Iterator[ast.AST]:
    assert isinstance(call.func, ast.Name)
    yield _with(call, func=ast.Name(OPPOSITE[call.func.id], ast.Load()))
    if len(call.args) > 1 and not any(isinstance(item, ast.Starred) for item in call.args):
        yield from (_without(call, dropped) for dropped in range(len(call.args)))


def _without(call: ast.Call, dropped: int) -> ast.AST:
    args = [item for index, item in enumerate(call.args) if index != dropped]
    return args[0] if len(args) == 1 else _with(call, args=args)


def _other_values(node: ast.Constant | ast.Return) -> Iterator[ast.AST]:
    match node:
        case ast.Constant(value=bool()):
            yield _with(node, value=not node.value)
        case ast.Constant(value=float(value)) if value:
            yield _with(node, value=value * 2.0)
            yield _with(node, value=value / 2.0)
        case ast.Constant(value=int(value) | float(value)):
            yield _with(node, value=value + 1)
        case ast.Return(value=ast.Constant(value="")):
            yield _with(node, value=ast.Constant("changed"))
        case ast.Return(value=ast.Constant(value=str()) | ast.JoinedStr()):
            yield _with(node, value=ast.Constant(""))


def _with(node: ast.AST, **changed: Any) -> ast.AST:
    other = copy.copy(node)
    for name, value in changed.items():
        setattr(other, name, value)
    return other


ROOT = Path(__file__).parent.parent
PACKAGES = (
    "edge.safety.relay_proof",
    "edge.core.hard_limits",
)  # whose tests take seconds; others are asked for by name


@dataclass(frozen=True, slots=True)
class FileMutant:
    """One changed place of one file."""

    path: Path  # from the root of the tree
    kind: str
    line: int
    text: str  # of the whole changed file


def module_files(package: str, root: Path) -> list[Path]:
    """Files of a package, or of one module, from `root`. Errors: ValueError"""
    place = root / package.replace(".", "/")
    found = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    if not found[0].exists():
        raise ValueError(f"there is no package or module {package!r}")
    return [path.relative_to(root) for path in found]


def mutants_of(path: Path, root: Path) -> Iterator[FileMutant]:
    """Every change of one file; decorators, annotations and formatted strings stay as they are."""
    source = (root / path).read_text(encoding="utf-8")
    tree = ast.parse(source)
    left_alone = set(_left_alone(tree))
    defaults = {id(item) for item in _defaults(tree)}
    for node in ast.walk(tree):
        if id(node) in left_alone or not isinstance(node, ast.expr | ast.stmt):
            continue
        for kind, changed in changes(node):
            is_default = kind == "constant" and id(node) in defaults
            text = _replace(source, node, changed)
            yield FileMutant(path, "keyword default" if is_default else kind, node.lineno, text)


def _left_alone(tree: ast.AST) -> Iterator[int]:
    for node in ast.walk(tree):
        roots: list[ast.AST] = [node] if isinstance(node, ast.JoinedStr) else []
        roots += getattr(node, "decorator_list", [])
        roots += [item for name in ("annotation", "returns") if (item := getattr(node, name, None))]
        for root in roots:
            yield from (id(inner) for inner in ast.walk(root))


def _defaults(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if isinstance(node, ast.arguments):
            yield from (item for item in (*node.defaults, *node.kw_defaults) if item is not None)


def _bytes_before(lines: Sequence[bytes], number: int) -> int:
    return sum(len(line) for line in lines[: number - 1])


def _replace(source: str, node: ast.expr | ast.stmt, changed: ast.AST) -> str:
    """Return the source with one node replaced. Columns of the tree count bytes."""
    lines = source.encode().splitlines(keepends=True)
    begin = _bytes_before(lines, node.lineno) + node.col_offset
    end = _bytes_before(lines, node.end_lineno or 0) + (node.end_col_offset or 0)
    by = ast.unparse(changed)
    if isinstance(changed, ast.expr) and not isinstance(changed, ast.Constant | ast.Name | ast.Call):
        by = f"({by})"
    whole = source.encode()
    return (whole[:begin] + by.encode() + whole[end:]).decode()


def importing_tests(package: str, root: Path) -> list[Path]:
    """Test files that import the package, directly or through helpers in tests/, from `root`."""
    imports = {path: imported_names(root / path) for path in _files_of_tests(root)}
    using = {path for path, names in imports.items() if _has(names, package)}
    while more := {
        path
        for path, names in imports.items()
        if path not in using and {user.stem for user in using} & {name.rpartition(".")[2] for name in names}
    }:
        using |= more
    return sorted(
        path for path in using if path.name.startswith("test_") and not _has(imports[path], IN_PROCESS)
    )


def _files_of_tests(root: Path) -> list[Path]:
    return [path.relative_to(root) for path in sorted((root / "tests").rglob("*.py"))]


def imported_names(path: Path) -> set[str]:
    """Names of modules, and of what is taken from them, with dots."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {item.name for item in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{item.name}" for item in node.names)}
    return names


def _has(names: set[str], package: str) -> bool:
    return any(name == package or name.startswith(f"{package}.") for name in names)


def copy_tree(root: Path, to: Path) -> None:
    """Copy what git tracks or would track. Errors: OSError, CalledProcessError"""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if (root / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, to / name)


def run_tests(tree: Path, tests: Sequence[Path], limit_s: float | None = None) -> tuple[str, str]:
    """Run the tests of a tree; return the outcome and the last lines that they print."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider"]
    paths = [str(tree), os.environ.get("PYTHONPATH", "")]
    # Sources change within the second that a cached byte code's time tells: none is written.
    told = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*command, *map(str, tests)],
            cwd=tree, env={**told, "CI": "1"}, capture_output=True, text=True, timeout=limit_s,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return TIMED_OUT, ""
    return SURVIVED if done.returncode == 0 else NOTICED, "\n".join(done.stdout.splitlines()[-15:])


def draw(package: str, seed: int, count: int, root: Path) -> tuple[int, list[FileMutant]]:
    """How many changes there are, and `count` of them by `seed`, each with equal chance."""
    everything = [mutant for path in module_files(package, root) for mutant in mutants_of(path, root)]
    return len(everything), random.Random(seed).sample(everything, min(count, len(everything)))


def difference(mutant: FileMutant, root: Path) -> str:
    """Return the changed lines, with one line around them."""
    before = (root / mutant.path).read_text(encoding="utf-8").splitlines()
    lines = difflib.unified_diff(before, mutant.text.splitlines(), lineterm="", n=1)
    return "\n".join(f"    {line}" for line in list(lines)[2:])


def bench_package(package: str, seed: int, count: int, limit_s: float | None, root: Path) -> Iterator[str]:
    """Yield the report on one package line by line. Errors: RuntimeError where the unchanged tests fail"""
    possible, mutants = draw(package, seed, count, root)
    tests = importing_tests(package, root)
    yield f"\n{package}: {len(mutants)} of {possible} changes, seed {seed}; {len(tests)} files of tests"
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder)
        copy_tree(root, tree)
        begin_s = time.monotonic()
        verdict, said = run_tests(tree, tests)
        if verdict != SURVIVED or not tests:
            raise RuntimeError(f"the tests fail without a change:\n{said}")
        limit_s = limit_s or max(LEAST_LIMIT_S, SLOWER * (time.monotonic() - begin_s))
        counts: Counter[tuple[str, str]] = Counter()
        for mutant in mutants:
            place = tree / mutant.path
            original = place.read_text(encoding="utf-8")
            place.write_text(mutant.text, encoding="utf-8")
            verdict, _ = run_tests(tree, _nearest_first(tests, mutant.path, root), limit_s)
            place.write_text(original, encoding="utf-8")
            counts[mutant.kind, verdict] += 1
            if verdict == SURVIVED:
                yield f"  survives: {mutant.path}:{mutant.line} ({mutant.kind})\n{difference(mutant, root)}"
    yield from _summary(counts)


def _nearest_first(tests: Sequence[Path], path: Path, root: Path) -> list[Path]:
    module = ".".join(path.with_suffix("").parts)

    def distance(test: Path) -> tuple[bool, bool]:
        return test.stem != f"test_{path.stem}", not _has(imported_names(root / test), module)

    return sorted(tests, key=distance)


def _summary(counts: Counter[tuple[str, str]]) -> Iterator[str]:
    verdicts = (NOTICED, TIMED_OUT, SURVIVED)
    yield f"  {'kind':18}" + "".join(f"{verdict:>11}" for verdict in verdicts)
    for kind in (*sorted({kind for kind, _ in counts}), "all"):
        row = [
            sum(n for (k, v), n in counts.items() if v == verdict and kind in (k, "all"))
            for verdict in verdicts
        ]
        yield f"  {kind:18}" + "".join(f"{number:11}" for number in row)


def main(words: Sequence[str] | None = None) -> int:
    """Print the report; 1 where the tests fail without any change."""
    parser = argparse.ArgumentParser(prog="python -m bench mutants", description=__doc__)
    parser.add_argument(
        "packages", nargs="*", metavar="PACKAGE", default=PACKAGES, help="or module, with dots"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40, help="changes of each package")
    parser.add_argument("--limit", type=float, metavar="S", help="of the tests of one change, wall time [s]")
    told = parser.parse_args(words)
    try:
        for package in told.packages:
            for line in bench_package(package, told.seed, told.count, told.limit, ROOT):
                print(line, flush=True)
    except (RuntimeError, ValueError) as error:
        print(f"{package}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
