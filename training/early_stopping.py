"""When to stop: no progress of the validation loss for so many epochs."""

import math
from dataclasses import dataclass


@dataclass(slots=True)
class EarlyStopping:
    """Counts epochs without progress.

    min_delta : what the loss must fall by, below the last that counted, to count as progress; here the loss
        is the MSE of the scaled target (variance 1 in the training data), the paper doesn't say
    tolerance : epochs without progress after which training stops
    """

    min_delta: float
    tolerance: int
    counted: float = math.inf
    waited: int = 0

    def is_over(self, loss: float) -> bool:
        """True at the epoch at which training stops. A NaN loss is no progress."""
        if loss < self.counted - self.min_delta:
            self.counted, self.waited = loss, 0
        else:
            self.waited += 1
        return self.waited >= self.tolerance
