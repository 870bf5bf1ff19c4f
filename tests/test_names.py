"""Names and docstrings that a reader meets: one class a name, openings with a verb or a noun."""

import ast
import functools
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parent.parent
PARTS = ("edge", "firmware_protocol", "fleet", "training", "bench", "tests")
BAD_OPENINGS = {"what", "of", "whether", "where"}  # the reader waits for the noun or the verb
PARTICIPLES = {
    "told",
    "given",
    "kept",
    "made",
    "said",
    "gone",
    "known",
    "shown",
    "taken",
    "drawn",
    "found",
    "held",
}
NO_PARTICIPLES = {"embed", "feed", "need", "proceed", "seed", "speed"}
NOTEBOOK = {"Run", "Twin"}  # `from edge import Run, Twin`: short on purpose, and not used inside


class Definition(NamedTuple):
    """A module, class or function. opening : the first words of its docstring"""

    file: str
    node: type[ast.AST]
    name: str
    is_at_top: bool
    is_value: bool  # a property
    opening: list[str]


@functools.cache
def definitions() -> list[Definition]:
    """All of them; each file is parsed once."""
    found = []
    for part in PARTS:
        for path in sorted((ROOT / part).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found += [_definition(path, node, node in tree.body) for node in ast.walk(tree) if _is_one(node)]
    return found


def _is_one(node: ast.AST) -> bool:
    return isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)


def _definition(path: Path, node: Any, is_at_top: bool) -> Definition:
    decorators = [ast.unparse(item) for item in getattr(node, "decorator_list", [])]
    opening = (ast.get_docstring(node) or "").split()[:6]
    is_value = any("property" in decorator for decorator in decorators)
    name = getattr(node, "name", "")
    return Definition(str(path.relative_to(ROOT)), type(node), name, is_at_top, is_value, opening)


def classes() -> dict[str, list[str]]:
    """Files by the classes that they define."""
    found = defaultdict(list)
    for one in definitions():
        if one.node is ast.ClassDef and one.is_at_top:
            found[one.name].append(one.file)
    return found


def test_no_class_name_stands_for_two_things() -> None:
    found = classes()
    assert len(found) > 500  # it does look at them
    assert {name: files for name, files in found.items() if len(files) > 1} == {}


def test_the_notebooks_names_are_those_of_one_file() -> None:
    found = classes()
    assert {name: found[name] for name in NOTEBOOK} == {
        name: ["edge/diagnosis/python.py"] for name in NOTEBOOK
    }


def test_no_function_is_called_by_a_bare_participle() -> None:
    bad = []
    for one in definitions():
        # A property may be an adjective: `if board.stopped`.
        is_function = one.node in (ast.FunctionDef, ast.AsyncFunctionDef) and not one.is_value
        word = one.name.strip("_")
        if (
            is_function
            and not one.file.startswith("tests/")
            and (
                word in PARTICIPLES
                or (word.endswith("ed") and "_" not in word and word not in NO_PARTICIPLES)
            )
        ):
            bad.append(f"{one.file}: {one.name}")
    assert bad == []


def test_no_docstring_opens_without_a_verb_or_a_noun() -> None:
    bad = [
        f"{one.file}: {' '.join(one.opening)}"
        for one in definitions()
        if one.opening and one.opening[0].strip("`,.:;").lower() in BAD_OPENINGS
    ]
    assert bad == []
