"""edge/twin/discretisation.py: what is interpolated is what each exponential is."""

import numpy as np
import pytest

from edge.twin.discretisation import MANY, exponential, exponentials

LENGTHS = np.array([5.0, 5.0, 2.5, 1e-3])
AIR_1_S = np.array([[-1.0, 0.0], [0.0, 0.0]])  # the fan at full speed changes the air within a second


@pytest.mark.parametrize("kinds", [1, 3])
@pytest.mark.parametrize("speeds", [1, MANY // 4, MANY])
def test_many_speeds_are_stepped_as_each_alone(kinds: int, speeds: int) -> None:
    draw = np.random.default_rng(speeds)
    rates = np.repeat(draw.random((kinds, 2, 2)) * [[-0.05, 0.05], [0.01, -0.01]], speeds, axis=0)
    fan = np.clip(draw.uniform(-0.1, 1.1, (len(LENGTHS), len(rates))), 0.0, 1.0)
    state, integral = exponentials(rates, AIR_1_S, fan, LENGTHS)
    for j, length in enumerate(LENGTHS):
        for s in range(0, len(rates), 17):
            alone = exponential(rates[s : s + 1] + fan[j, s] * AIR_1_S, length)
            np.testing.assert_allclose(state[j, s], alone[0][0], atol=1e-13)
            np.testing.assert_allclose(integral[j, s], alone[1][0], atol=1e-12)
