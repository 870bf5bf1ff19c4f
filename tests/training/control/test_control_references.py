"""References and effort: what is kept is what is drawn, inside what the box can do."""

from pathlib import Path

import pytest

from edge.formats.profile_file import read_profile
from training.control.draw_references import FOLDER, SEGMENTS, text
from training.control.effort import FAMILIES, lines


@pytest.mark.parametrize("name", SEGMENTS)
def test_the_kept_reference_is_the_drawn_one(name):
    assert (FOLDER / f"{name}.csv").read_text(encoding="utf-8") == text(name)


@pytest.mark.parametrize("name", SEGMENTS)
def test_a_reference_lies_where_the_box_can_follow(name):
    values = read_profile(FOLDER / f"{name}.csv").columns["reference_c"]
    assert values.min() >= 22.0
    assert values.max() <= 35.0


def test_the_references_are_as_long_as_the_papers():
    assert read_profile(FOLDER / "reference_1.csv").end_s == 212 * 60
    assert read_profile(FOLDER / "reference_2.csv").end_s == 24 * 3600


def test_only_code_is_counted(tmp_path: Path):
    (tmp_path / "one.py").write_text(
        '"""A docstring."""\n\n# a comment\nx = """\ntwo\n"""\n\n\ndef f():\n    "said"\n'
    )
    assert lines(["one.py"], tmp_path) == 4  # three of the string, one of the function


def test_a_file_that_is_not_there_has_no_lines(tmp_path: Path):
    assert lines(["nothing.py", "nowhere"], tmp_path) == 0


def test_every_family_says_why_it_needs_its_knowledge():
    assert all(1 <= family.knowledge <= 5 and family.why for family in FAMILIES)
