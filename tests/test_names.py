"""Names and docstrings that a reader meets: one class a name, openings with a verb or a noun."""

import ast
from collections import defaultdict
from pathlib import Path

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


def classes() -> dict[str, list[str]]:
    """Files by the classes that they define."""
    found = defaultdict(list)
    for part in PARTS:
        for path in sorted((ROOT / part).rglob("*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef):
                    found[node.name].append(str(path.relative_to(ROOT)))
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
    for part in PARTS[:-1]:
        for path in sorted((ROOT / part).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    continue
                # A property may be an adjective: `if board.stopped`.
                is_value = any("property" in ast.unparse(item) for item in node.decorator_list)
                word = node.name.strip("_")
                if not is_value and (
                    word in PARTICIPLES
                    or (word.endswith("ed") and "_" not in word and word not in NO_PARTICIPLES)
                ):
                    bad.append(f"{path.relative_to(ROOT)}: {node.name}")
    assert bad == []


def test_no_docstring_opens_without_a_verb_or_a_noun() -> None:
    bad = []
    for part in PARTS:
        for path in sorted((ROOT / part).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                    continue
                words = (ast.get_docstring(node) or "").split()
                if words and words[0].strip("`,.:;").lower() in BAD_OPENINGS:
                    bad.append(f"{path.relative_to(ROOT)}: {' '.join(words[:6])}")
    assert bad == []
