"""References: what is kept is what is drawn, inside what the box can do."""

import pytest

from edge.formats.profile_file import read_profile
from training.control.draw_references import FOLDER, SEGMENTS, text


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
