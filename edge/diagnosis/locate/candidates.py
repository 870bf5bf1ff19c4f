"""How well an open door, a wrong reading or a lasting jump explains a run's innovations, at every place.

Each is a shape with one unknown size, so its likelihood gain is that of a matched filter: score squared over
twice the information (generalised likelihood ratio; Willsky & Jones 1976, IEEE TAC 21).

A filter is linear: the change of all later innovations by heat, a wrong reading or a jump in one row is
known beforehand. Its fit to the observed innovations gives the likelihood of that event.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residual_heat import HeatFilterResult, Steps

Floats = NDArray[np.float64]
LAGS = 400  # rows after which a response is forgotten


def white(way: HeatFilterResult) -> Floats:
    """Innovations in standard deviations, [B, N]; 0 where nothing was measured."""
    return np.asarray(np.nan_to_num(way.innovation) / np.sqrt(way.variance)).T


def pulses(steps: Steps, way: HeatFilterResult) -> Floats:
    """Response to 1 W during step i alone, [B, N, J]: element j is that of the row after step i + j."""
    return _responses(steps, way, steps.matrix[..., -1])


def jumps(steps: Steps, way: HeatFilterResult) -> Floats:
    """Return the innovations for 1 W from step i on."""
    return _responses(steps, way, steps.matrix[..., -2])


def spikes(steps: Steps, way: HeatFilterResult) -> Floats:
    """Return the innovations if only the reading after step i is 1 K too high."""
    shown = _scale(way, np.ones_like(way.innovation), 0)
    later = -np.einsum("kbij,kbj->kbi", steps.matrix[1:], way.gain[:-1])
    rest = _responses(steps, way, np.concatenate([np.zeros_like(way.gain[:1]), later]))
    # In place, as a second array of this size is what a small machine lacks.
    for run in rest:
        run[:-1, 1:] = run[1:, :-1]
    rest[:, -1, 1:] = 0.0
    rest[:, :, 0] = shown.T
    return rest


def _responses(steps: Steps, way: HeatFilterResult, state: Floats) -> Floats:
    """state : [N, B, m], by how much the row's state after step i is off what the filter expects."""
    rows, count = way.innovation.shape
    lags = min(rows, LAGS)
    found = np.zeros((count, rows, lags))
    for lag in range(lags):
        reach = rows - lag
        state = state[:reach]
        found[:, :reach, lag] = _scale(way, state[..., 0], lag).T
        state = state - way.gain[lag:] * state[..., :1]
        if reach > 1:
            state = np.einsum("kbij,kbj->kbi", steps.matrix[lag + 1 :], state[:-1])
    return found


def _scale(way: HeatFilterResult, shown: Floats, lag: int) -> Floats:
    measured = np.isfinite(way.innovation[lag:])
    return np.where(measured, shown / np.sqrt(way.variance[lag:]), 0.0)


def score(response: Floats, innovations: Floats) -> Floats:
    """Sum over later rows of response times innovation, [N].

    response : [N, J] of one run; innovations : [N], white
    """
    lags = response.shape[1]
    later = np.lib.stride_tricks.sliding_window_view(np.pad(innovations, (0, lags - 1)), lags)
    return np.asarray(np.einsum("nj,nj->n", response, later))


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
