"""edge/app/commission.py: a heater that fades, and a sensor with coarse steps."""

from typing import Any

import numpy as np
import pytest

from edge.app.commission import search_past_steps, step_of
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


DRAW = np.random.default_rng(1)
AIR_C = 22.0 + 6.0 * np.sin(np.linspace(0.0, 12.0, 720)) + 0.05 * DRAW.standard_normal(720)


def shown(step_k: float, samples: int = 3) -> np.ndarray:
    """Means of samples in steps."""
    noise = 0.03 * DRAW.standard_normal((samples, len(AIR_C)))
    return np.mean(step_k * np.round((AIR_C + noise) / step_k), axis=0)


@pytest.mark.parametrize("step_k", [1.0, 0.5, 0.25])
def test_a_coarse_step_is_found_behind_a_mean_an_offset_and_holes(step_k):
    assert step_of(shown(step_k)) == step_k
    assert step_of(shown(step_k) + 0.37) == step_k
    assert step_of(np.where(np.arange(len(AIR_C)) % 7 == 0, np.nan, shown(step_k))) == step_k


@pytest.mark.parametrize("step_k", [0.1, 0.0625, 0.01])
def test_a_fine_step_is_none_to_care_for(step_k):
    assert step_of(shown(step_k)) == 0.0


def test_where_the_air_hardly_moved_nothing_is_claimed():
    assert step_of(np.full(100, 21.5)) == 0.0
    assert step_of(np.array([np.nan, np.nan])) == 0.0


def test_a_step_coarser_than_a_quarter_of_what_was_seen_cannot_be_told():
    assert step_of(np.where(np.arange(100) < 50, 21.0, 22.0)) == 0.25
