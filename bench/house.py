"""python -m bench house: figures of the source tree beside their goals.

Counts tracked files only. A docstring opens badly with What, Of, Whether or Where. A long function without an
own-line comment does not say why it does what it does. Shares of random changes that tests notice are
printed by `python -m bench mutants`, in hours.
"""

import ast
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parent.parent
PRODUCT = ("edge", "firmware_protocol", "training", "bench")
BAD_OPENINGS = ("what", "of", "whether", "where")
LONG_LINES = 25
# A reader who had seen nothing but `git ls-files` named these files (2026-11-24). A row is a hit as long as
# the file still defines what was looked for.
LOOK_UPS = (
    ("how long a command holds (lease)", "firmware_protocol/c/gh_safety.c", "gh_safety_lease_left_ms("),
    ("observation of the RL policy", "edge/models/policy_observation.py", "def observe_tick("),
    ("where a missing effect is named", "edge/diagnosis/verdict.py", "def verdict("),
    ("MQTT topics", "edge/mqtt/topics.py", "class Topics"),
    ("reward of the RL training", "training/rl/reward.py", "def reward("),
    ("fallback of a late controller", "edge/tick/decider.py", "class Decider"),
    ("sensor calibration", "", "calibration.gain *"),  # stands in edge/tick/calibration.py; not found
    ("orders of an operator", "edge/tick/orders.py", "def apply_orders("),
    ("state that survives a restart", "edge/state/store.py", "class StoredValue"),
    ("tables of the history", "edge/storage/schema.py", "def create_tables("),
    ("rule against over-temperature", "edge/safety/rules.py", "def too_hot("),
    ("check of a signature", "edge/bundle/signature.py", "def check_signature("),
    ("watchdog of the service", "edge/app/systemd.py", "def watchdog_s("),
    ("comparison of two controllers", "training/control/compare.py", "def energy_table("),
)
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def tracked_files(pattern: str = "*") -> list[Path]:
    """Return the tracked files that match, from the root of the checkout."""
    command = ["git", "ls-files", pattern]
    lines = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return [Path(line) for line in lines if (ROOT / line).is_file()]


def imports_between(trees: Mapping[Path, ast.Module]) -> dict[str, set[str]]:
    """Return the modules of this repository that each module imports, also inside functions."""
    names = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in trees}
    graph: dict[str, set[str]] = {}
    for name, path in names.items():
        wanted = set(_imported_names(trees[path]))
        graph[name] = {other for other in wanted if other in names and other != name}
    return graph


def _imported_names(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def rings(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the groups of two or more modules that reach each other."""
    reached = {name: _reachable(name, graph) for name in graph}
    groups: dict[frozenset[str], None] = {}
    for name in graph:
        group = frozenset(other for other in reached[name] if name in reached[other]) | {name}
        if len(group) > 1:
            groups[group] = None
    return [sorted(group) for group in groups]


def _reachable(start: str, graph: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    open_names = [start]
    while open_names:
        for other in graph.get(open_names.pop(), ()):
            if other not in found:
                found.add(other)
                open_names.append(other)
    return found


def rooms(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the same between folders of edge/ (`edge.tick`) and other top-level folders."""
    between: dict[str, set[str]] = defaultdict(set)
    for name, others in graph.items():
        between[_room(name)] |= {_room(other) for other in others} - {_room(name), "edge"}
    return dict(between)


def _room(name: str) -> str:
    return ".".join(name.split(".")[: 2 if name.startswith("edge.") else 1])


def documented_nodes(tree: ast.Module) -> Iterator[Documented]:
    """Yield the module and everything in it that may have a docstring."""
    for node in ast.walk(tree):
        if isinstance(node, Documented):
            yield node


def opens_badly(node: Documented) -> bool:
    """Return whether a docstring opens with a word that names neither an action nor a thing."""
    words = (ast.get_docstring(node) or "").split()
    return bool(words) and words[0].strip("`,.:;").lower() in BAD_OPENINGS


def unexplained_functions(source: str, tree: ast.Module) -> int:
    """Return the number of long functions without an own-line comment."""
    lines = source.splitlines()
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    bodies = [lines[node.lineno - 1 : node.end_lineno] for node in functions]
    return sum(
        len(body) > LONG_LINES and not any(line.lstrip().startswith("#") for line in body) for body in bodies
    )


def missed_look_ups() -> list[str]:
    """Return the questions whose named file does not hold the answer."""
    return [
        question
        for question, file, definition in LOOK_UPS
        if not (file and definition in (ROOT / file).read_text(encoding="utf-8"))
    ]


def figures() -> list[tuple[str, float, float]]:
    """Return each figure's name, its value and the largest value that meets the goal."""
    sources = {path: (ROOT / path).read_text(encoding="utf-8") for path in tracked_files("*.py")}
    trees = {path: ast.parse(source) for path, source in sources.items()}
    product = [path for path in sources if path.parts[0] in PRODUCT]
    graph = imports_between({path: trees[path] for path in product})
    files = {name: others - {name.rpartition(".")[0]} for name, others in graph.items()}
    # A class inside a function is nobody else's.
    classes = Counter(
        node.name for tree in trees.values() for node in tree.body if isinstance(node, ast.ClassDef)
    )
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return [
        ("lines of Python", sum(len(source.splitlines()) for source in sources.values()), 78_000),
        (
            "  of these in tests",
            sum(len(sources[path].splitlines()) for path in sources.keys() - product),
            -1,
        ),
        ("modules without tests", len(product), 400),
        (
            "entries at the top of edge/ that are files",
            len([p for p in product if p.parent == Path("edge")]),
            2,
        ),
        ("rings of rooms", len(rings(rooms(graph))), 0),
        ("rings of files", len(rings(files)), 0),
        ("class names used twice", sum(count > 1 for count in classes.values()), 0),
        (
            "docstrings that open with What, Of, Whether, Where",
            sum(opens_badly(node) for tree in trees.values() for node in documented_nodes(tree)),
            0,
        ),
        (
            f"functions over {LONG_LINES} lines without a comment",
            sum(unexplained_functions(sources[path], trees[path]) for path in product),
            0,
        ),
        ("lines of the README", len(readme.splitlines()), 150),
        ("look-ups missed from the names of the files, of 14", len(missed_look_ups()), 1),
        ("MB tracked", round(sum((ROOT / path).stat().st_size for path in tracked_files()) / 1e6, 1), 14),
    ]


def main() -> int:
    """Print the table; 0 whatever it says."""
    print(f"{'figure':52s} {'now':>9s} {'goal':>9s}")
    for name, value, goal in figures():
        print(f"{name:52s} {value:9g} {'' if goal < 0 else format(goal, '9g')}".rstrip())
    return 0


if __name__ == "__main__":
    sys.exit(main())
