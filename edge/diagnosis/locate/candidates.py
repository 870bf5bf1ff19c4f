"""How well an open door, a wrong reading or a lasting jump explains a run's innovations, at every place.

Each is a shape with one unknown size, so its likelihood gain is that of a matched filter: score squared over
twice the information (generalised likelihood ratio; Willsky & Jones 1976, IEEE TAC 21).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.whitening import score

Floats = NDArray[np.float64]
LONGEST = 20  # rows that a door may be open


class EventShape(NamedTuple):
    """kind : door, spike or jump; input and late are a door's and a spike's that come when an input changes

    begin, end : rows [begin, end) of a run; size : W/K, K or W; z : size over its sd
    """

    kind: str
    begin: int
    end: int
    size: float
    z: float


class ShapeScores(NamedTuple):
    """z and size of a shape that begins with each row, [N, L], for 1 .. L rows; 0 past the end."""

    z: Floats
    size: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RunShapes:
    """One run's responses: to a door of 1 W/K in a step, a reading 1 K off, 1 W from a step on; [N, J] each.

    excess : T - T_amb at the end of each step, [N] [K]
    """

    door: Floats
    spike: Floats
    jump: Floats
    excess: Floats
    door_information: Floats = field(init=False)  # [N, LONGEST], of doors by begin and length

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "door_information", _of_lengths(self.door)
        )  # frozen for all but its own making

    def response(self, shape: EventShape) -> Floats:
        """White innovations that a shape of size 1 causes, [N]."""
        source = {"spike": self.spike, "late": self.spike, "jump": self.jump}.get(shape.kind, self.door)
        found = np.zeros(len(source))
        for row in range(shape.begin, shape.end):
            reach = min(source.shape[1], len(source) - row)
            found[row : row + reach] += source[row, :reach]
        return found

    def doors(self, innovations: Floats) -> ShapeScores:
        """For 1 .. LONGEST rows."""
        single = np.append(0.0, np.cumsum(score(self.door, innovations)))
        rows = len(innovations)
        numerator = np.zeros((rows, LONGEST))
        for length in range(1, min(LONGEST, rows) + 1):
            numerator[: rows - length + 1, length - 1] = single[length:] - single[:-length]
        return _scores(numerator, self.door_information)

    def spikes(self, innovations: Floats) -> ShapeScores:
        """Score a wrong reading after each step, L = 1."""
        return _scores(score(self.spike, innovations)[:, None], (self.spike**2).sum(axis=1)[:, None])

    def jumps(self, innovations: Floats) -> ShapeScores:
        """Heat that stays from each step on, L = 1."""
        return _scores(score(self.jump, innovations)[:, None], (self.jump**2).sum(axis=1)[:, None])


def _of_lengths(response: Floats) -> Floats:
    """Information on doors by begin and length, [N, LONGEST]; 0 past the end."""
    rows = len(response)
    shared = np.stack([_shared_information(response, lag) for lag in range(LONGEST)], axis=1)
    found, sums = np.zeros((rows, LONGEST)), np.zeros(rows)
    for length in range(1, min(LONGEST, rows) + 1):
        last = np.arange(length - 1, rows)
        sums = sums[: len(last)] + shared[last, 0]
        for lag in range(1, length):
            sums = sums + 2.0 * shared[last - lag, lag]
        found[: len(last), length - 1] = sums
    return found


def _shared_information(response: Floats, lag: int) -> Floats:
    """Information that a step shares with the step `lag` rows later, [N]."""
    shared = np.zeros(len(response))
    if lag < len(response):
        reach = len(response) - lag
        shared[:reach] = (response[:reach, lag:] * response[lag:, : response.shape[1] - lag]).sum(axis=1)
    return shared


def _scores(numerator: Floats, information: Floats) -> ShapeScores:
    known = np.maximum(information, 1e-12)  # where a shape changes nothing, nothing is known of it
    return ShapeScores(numerator / np.sqrt(known), numerator / known)
