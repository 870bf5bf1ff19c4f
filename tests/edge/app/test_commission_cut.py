"""A heater that fades in warm air is not taken for one that is cut, where it foretells as well."""

from typing import Any

import pytest

from edge.app.commission import search_past_steps
from edge.diagnosis.unknowns import with_usual
from edge.twin.twin_file import TwinFile
from tests.support.simulated_runs import twin_file

CUT, FADING = "unnamed_cut", "heater_derating"


@pytest.mark.parametrize(
    ("without_k", "with_k", "cuts_again", "taken"),
    [(0.5, 0.4, False, FADING), (0.5, 0.5, False, FADING), (0.4, 0.5, False, CUT), (0.5, 0.4, True, CUT)],
)
def test_a_heater_that_fades_is_tried_where_a_cut_is_found(
    without_k: float, with_k: float, cuts_again: bool, taken: str
) -> None:
    def search(begin: TwinFile) -> tuple[Any, TwinFile, float]:
        fades = FADING in begin.effects
        found = begin if fades and not cuts_again else with_usual(begin, CUT)
        return None, found, with_k if fades else without_k

    _, twin, error_k = search_past_steps(twin_file(), search)
    assert taken in twin.effects and error_k == (with_k if taken == FADING else without_k)


def test_without_a_cut_there_is_one_search() -> None:
    begun = []

    def search(begin: TwinFile) -> tuple[Any, TwinFile, float]:
        begun.append(begin)
        return None, begin, 0.3

    assert search_past_steps(twin_file(), search)[1:] == (twin_file(), 0.3)
    assert begun == [twin_file()]
