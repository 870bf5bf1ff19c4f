"""How much an effect does, and the strength at which it does what is asked for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from bench.hidden_effects.draw_inputs import BEFORE_ROWS
from bench.hidden_effects.equations import NEUTRAL, simulate
from bench.hidden_effects.equations_inputs import Bend, ColumnInputs, Floats

MARGIN = 0.15
Parameters = Mapping[str, float]


def quiet(inputs: ColumnInputs) -> ColumnInputs:
    """Return the inputs without heat noise and with the mains as rated."""
    return replace(inputs, power=np.ones_like(inputs.power), heat_w=np.zeros_like(inputs.heat_w))


def variants(
    inputs: ColumnInputs, boxes: Sequence[Parameters], bend: Bend | None = None
) -> tuple[Floats, Floats]:
    """Simulate the same runs in several boxes: readings [V, N + 1, B] and states [V, N + 1, S, B]."""
    count = inputs.duty.shape[1]
    names = sorted({name for box in boxes for name in box})
    values = {name: np.repeat([box.get(name, NEUTRAL[name]) for box in boxes], count) for name in names}
    shown, states = simulate(values, inputs.columns(list(range(count)) * len(boxes)), bend=bend)
    by_box = shown.reshape(len(shown), len(boxes), count).transpose(1, 0, 2)
    return by_box, states.reshape(*states.shape[:2], len(boxes), count).transpose(2, 0, 1, 3)


def rms_k(difference: Floats, rows: Sequence[int]) -> Floats:
    """Over all recorded rows of all runs; difference : [..., N + 1, B]."""
    row = np.arange(difference.shape[-2])[:, None] - BEFORE_ROWS
    recorded = (row >= 0) & (row < np.asarray(rows))
    return np.asarray(np.sqrt((difference**2 * recorded).sum(axis=(-2, -1)) / recorded.sum()))


def strength_for(
    rng: Generator,
    strengths: Floats,
    sizes: Floats,
    wanted: tuple[float, float],
) -> float | None:
    """Draw a strength whose size is inside `wanted`, evenly on a logarithmic scale; None where there is none.

    sizes : at `strengths`, between which they are interpolated, so it keeps away from the ends
    """
    rising = np.maximum.accumulate(np.maximum(sizes, 1e-9))
    low, high = max(wanted[0] * (1.0 + MARGIN), rising[0]), min(wanted[1] / (1.0 + MARGIN), rising[-1])
    if not low < high or not np.isfinite(rising).all():
        return None
    target = np.exp(rng.uniform(np.log(low), np.log(high)))
    return float(np.exp(np.interp(np.log(target), np.log(rising), np.log(strengths))))
