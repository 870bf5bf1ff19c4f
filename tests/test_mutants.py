"""tools/mutants.py: a mutant is found again when its lines have moved."""

from pathlib import Path

from tools.mutants import draw, find

CODE = "LIMIT = 3\n\n\ndef is_low(value):\n    return value < LIMIT\n"


def room(tree: Path, **files: str) -> Path:
    for name in ("safety", "tick", "board", "storage", "bundle", "mqtt", "formats"):
        (tree / "edge" / name).mkdir(parents=True)
    for name, text in files.items():
        (tree / "edge" / "safety" / f"{name}.py").write_text(text)
    return tree


def test_mutants_are_drawn_by_seed_and_found_again(tmp_path: Path) -> None:
    before = room(tmp_path / "before", rules=CODE)
    drawn = draw(before, 6, (1, 2))
    assert len({(mutant["before"], mutant["after"]) for mutant in drawn}) == len(drawn) > 3
    shifted = room(tmp_path / "shifted", other="", moved=f"import math\n\n{CODE}")
    found = [find(shifted, mutant) for mutant in drawn]
    assert [m and (m["after"], m["line"]) for m in found] == [(m["after"], m["line"] + 2) for m in drawn]
    assert {m and m["module"] for m in found} == {"edge/safety/moved.py"}


def test_a_mutant_whose_line_has_changed_is_gone(tmp_path: Path) -> None:
    drawn = draw(room(tmp_path / "before", rules=CODE), 6, (1, 2))
    after = room(tmp_path / "after", rules=CODE.replace("LIMIT", "MOST"))
    assert [find(after, mutant) for mutant in drawn] == [None] * len(drawn)
