"""An input sequence as parts that hold for some rows, and many of them as arrays."""

from collections.abc import Sequence as Many
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.limits import ExperimentLimits

Floats = NDArray[np.float64]


class SequencePart(NamedTuple):
    """Inputs that hold for `rows` rows."""

    rows: int
    duty: float
    fan: float
    light: float = 0.0


Sequence = tuple[SequencePart, ...]


def rows_of(sequence: Sequence) -> int:
    """Length of a sequence."""
    return sum(part.rows for part in sequence)


@dataclass(frozen=True, slots=True, eq=False)
class SequenceInputs:
    """B sequences over N rows, off behind their ends.

    wanted : duty as a profile has it; duty : as safety sends it; all [B, N]
    within : whether the row belongs to the sequence; allowed : [B], by safety but for the temperature
    """

    row_s: float
    wanted: Floats
    duty: Floats
    fan: Floats
    light: Floats
    within: NDArray[np.bool_]
    allowed: NDArray[np.bool_]

    def choose(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> "SequenceInputs":
        """Return the sequences that `which` selects."""
        return SequenceInputs(
            self.row_s,
            self.wanted[which],
            self.duty[which],
            self.fan[which],
            self.light[which],
            self.within[which],
            self.allowed[which],
        )


def inputs_of(sequences: Many[Sequence], limits: ExperimentLimits, row_s: float) -> SequenceInputs:
    """Return heater, fan and light under the sequences."""
    rows = max(rows_of(sequence) for sequence in sequences)
    columns = np.zeros((4, len(sequences), rows))
    for i, sequence in enumerate(sequences):
        begin = 0
        for part in sequence:
            columns[:, i, begin : begin + part.rows] = np.array(
                [limits.duty(part.duty), part.fan, min(part.light, limits.safety.led_max), 1.0]
            )[:, None]
            begin += part.rows
    wanted, fan, light, within = columns
    duty = limits.limit_rise(wanted, row_s)
    return SequenceInputs(row_s, wanted, duty, fan, light, within > 0.0, limits.are_within(duty, fan, row_s))
