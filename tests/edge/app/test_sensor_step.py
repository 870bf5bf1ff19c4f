"""edge/app/sensor_step.py"""

import numpy as np
import pytest

from edge.app.sensor_step import step_of

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
