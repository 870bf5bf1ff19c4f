"""Small subsets of many regressors, by the Bayesian criterion with a price for the size of the library."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BEAM = 12  # subsets of a size that are carried on
LARGEST = 4  # terms


@dataclass(frozen=True, slots=True, eq=False)
class SumRegression:
    """Least squares from sums alone. gram : [p, p]; product : [p], with what is explained; total : its square

    rows : that tell something
    """

    gram: Floats
    product: Floats
    total: float
    rows: int

    @classmethod
    def of(cls, columns: Floats, explained: Floats, rows: int) -> "SumRegression":
        """columns : [R, p], scaled to length 1 so that the criterion does not depend on units."""
        return cls(columns.T @ columns, columns.T @ explained, float(explained @ explained), rows)

    def remainder(self, subset: Sequence[int]) -> float:
        """Sum of squares that a subset leaves."""
        if not subset:
            return self.total
        places = list(subset)
        matrix = self.gram[np.ix_(places, places)] + 1e-9 * np.eye(len(places))
        return max(
            self.total - float(self.product[places] @ np.linalg.solve(matrix, self.product[places])), 1e-12
        )

    def cost(self, subset: Sequence[int], library: int) -> float:
        """Twice the negative log-likelihood, the noise's size fitted, with the price of the terms (EBIC).

        Chen & Chen 2008, Biometrika 95.
        """
        price = np.log(self.rows) + 2.0 * np.log(max(library, 2))
        return float(self.rows * np.log(self.remainder(subset) / self.rows) + len(subset) * price)

    def best(self, allowed: Sequence[int]) -> tuple[int, ...]:
        """Return the subset of `allowed` of least cost, found by a beam over sizes."""
        library = len(self.product)
        beam: list[tuple[int, ...]] = [()]
        winner: tuple[int, ...] = ()
        least = self.cost(winner, library)
        for _ in range(LARGEST):
            grown = {tuple(sorted((*subset, i))) for subset in beam for i in allowed if i not in subset}
            if not grown:
                break
            beam = sorted(grown, key=lambda subset: self.remainder(subset))[:BEAM]
            cost = self.cost(beam[0], library)
            if cost < least:
                winner, least = beam[0], cost
        return winner
