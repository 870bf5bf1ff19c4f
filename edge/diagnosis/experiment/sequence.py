"""An input sequence as parts that hold for some rows, many of them as arrays, and the limits that they
keep.
"""

from collections.abc import Sequence as Many
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import SafetySettings
from edge.core.names import HEATER_LEVELS, HEATER_MAX_W
from edge.safety.memory import HEAT_BUCKET_S

Floats = NDArray[np.float64]
HOUR_S, DAY_S = 3600.0, 86400.0
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class ExperimentLimits:
    """Limits of a designed experiment.

    safety : of the rig; step_s : its control step, on which a profile's rows stand
    longest_s : duration; margin_k : below the temperature at which safety steps in
    heater_w : at full duty, for the caps on energy
    """

    safety: SafetySettings = field(default_factory=SafetySettings)
    step_s: float = 60.0
    longest_s: float = 10800.0
    margin_k: float = 2.0
    heater_w: float = HEATER_MAX_W

    @property
    def highest_c(self) -> float:
        """Highest air temperature that a rival may predict."""
        return self.safety.temp_air_max_c - self.margin_k

    def row_s(self, sample_s: float) -> float:
        """Return the length of a plan's row: the fewest control steps that are
        no shorter than the twin's step [s].
        """
        return float(self.step_s * np.ceil(sample_s / self.step_s - ROUNDING))

    def dwell_rows(self, row_s: float) -> int:
        """Fewest rows that the fan's relay stays as it is."""
        longest_s = max(self.safety.fan_min_on_s, self.safety.fan_min_off_s)
        return max(1, int(np.ceil(longest_s / row_s - ROUNDING)))

    def duty(self, level: float) -> float:
        """Return the next lower duty that may be sent."""
        return (
            float(np.floor(min(level, self.safety.heater_max_duty) * HEATER_LEVELS + ROUNDING))
            / HEATER_LEVELS
        )

    def limit_rise(self, duty: Floats, row_s: float) -> Floats:
        """Duties [B, N] after the limit on their rise, which begins at 0."""
        found, ramp = np.empty_like(duty), np.zeros(len(duty))
        for k in range(duty.shape[1]):
            ramp = np.minimum(duty[:, k], ramp + self.safety.heater_rise_per_s * row_s)
            found[:, k] = np.floor(ramp * HEATER_LEVELS + ROUNDING) / HEATER_LEVELS
        return found

    def are_within(self, duty: Floats, fan: Floats, row_s: float) -> NDArray[np.bool_]:
        """Which of [B, N] keep the relay's times and the caps on energy, [B]."""
        relay = [self._keeps_relay(row, row_s) for row in fan]
        hour = self._most_wh(duty, row_s, HOUR_S, self.safety.energy_hour_max_wh)
        day = self._most_wh(duty, row_s, DAY_S, self.safety.energy_day_max_wh)
        return (
            np.array(relay)
            & (hour <= self.safety.energy_hour_max_wh)
            & (day <= self.safety.energy_day_max_wh)
        )

    def _most_wh(self, duty: Floats, row_s: float, window_s: float, cap_wh: float) -> Floats:
        """Most heat that safety may count in a window, [B]; 0 where the heater can't reach the cap."""
        if cap_wh >= self.heater_w * window_s / HOUR_S:
            return np.zeros(len(duty))
        # Heat is counted in pieces, and with what comes next.
        rows = round((window_s + HEAT_BUCKET_S) / row_s) + 1
        sums = np.pad(np.cumsum(duty, axis=1), ((0, 0), (rows, 0)))
        return np.asarray((sums[:, rows:] - sums[:, :-rows]).max(axis=1) * self.heater_w * row_s / HOUR_S)

    def _keeps_relay(self, fan: Floats, row_s: float) -> bool:
        """Return whether the relay's shortest times hold. The first state may be
        short, since it began earlier; so may the last.
        """
        switches = np.flatnonzero(np.diff(fan, prepend=0.0))
        for begin, end in pairwise(switches):
            least_s = self.safety.fan_min_on_s if fan[begin] else self.safety.fan_min_off_s
            if (end - begin) * row_s < least_s - ROUNDING:
                return False
        return True


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
