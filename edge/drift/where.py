"""In which regime the twin errs most: a running table of squared innovations."""

import numpy as np
from numpy.typing import NDArray

from edge.core.messages import DriftRow
from edge.drift.evidence import CUT
from edge.drift.regimes import REGIMES

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
MEMORY_S = 3600.0  # older ticks count e times less: what is told is of now, with the time before beside it
CLEARLY = 3.0  # standard errors between inside and outside, to blame a regime
NEARLY_ALL = 0.9  # of the strongest evidence
_COLUMNS = 4  # count, squares, squares of squares, errors


def empty() -> Floats:
    """Return the empty table, [regimes, 4]."""
    return np.zeros((len(REGIMES), _COLUMNS))


def note(table: Floats, white: float, error_k: float, regimes: Flags, step_s: float) -> Floats:
    """Return the table one tick later."""
    square = min(white**2, CUT**2)
    kept: Floats = table * np.exp(-step_s / MEMORY_S)
    kept[regimes] += (1.0, square, square**2, error_k)
    return kept


def rows(table: Floats) -> list[DriftRow]:
    """By regime; nothing is seen where a regime was not lately."""
    total = float(table[0, 1])
    return [
        DriftRow(
            ticks=count,
            share_of_squares=squares / total if total > 0.0 else 0.0,
            error_k=errors / count if count > 0.0 else 0.0,
        )
        for count, squares, _, errors in table.tolist()
    ]


def worst(table: Floats, explained: Floats) -> int:
    """Place in REGIMES of the one to blame.

    explained : evidence in each regime [regimes]
    Of the regimes that explain nearly all of the evidence, the one whose squares stand out most from those
    outside it; where none does, the first, which is the most general.
    """
    candidates = explained >= NEARLY_ALL * explained.max()
    inside, whole = table, table[0]
    outside = whole - inside
    n_in, n_out = np.maximum(inside[:, 0], 1.0), np.maximum(outside[:, 0], 1.0)
    mean_in, mean_out = inside[:, 1] / n_in, outside[:, 1] / n_out
    # Spread within, not over all: what sets a regime apart is no noise.
    within = inside[:, 2] - n_in * mean_in**2 + outside[:, 2] - n_out * mean_out**2
    variance = np.maximum(within / max(whole[0], 1.0), 1e-9) * (1.0 / n_in + 1.0 / n_out)
    seen = (inside[:, 0] >= 1.0) & (outside[:, 0] >= 1.0)
    apart = np.where(candidates & seen, (mean_in - mean_out) / np.sqrt(variance), 0.0)
    place = int(np.argmax(apart))
    return place if apart[place] > CLEARLY else int(np.argmax(candidates))
