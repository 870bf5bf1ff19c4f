"""How well an open door, a wrong reading or a lasting jump explains a run's innovations, at every place.

Each is a shape with one unknown size, so its likelihood gain is that of a matched filter: score squared over
twice the information (generalised likelihood ratio; Willsky & Jones 1976, IEEE TAC 21).

A filter is linear: the change of all later innovations by heat, a wrong reading or a jump in one row is
known beforehand. Its fit to the observed innovations gives the likelihood of that event.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.heat_filter import Steps
from edge.twin.filter import InnovationGain

Floats = NDArray[np.float64]
LAGS = 400  # rows after which a response is forgotten
ShapeKind = Literal["door", "spike", "jump"]
LONGEST: dict[ShapeKind, int] = {"door": 20, "spike": 1, "jump": 1}  # rows that a shape may last


class EventShape(NamedTuple):
    """A shape in rows [begin, end) of a run.

    size : in shares of the heater's power per K, K, or shares of the power, by kind; z : size over its sd
    is_event : not what usually comes with a change of an input
    """

    kind: ShapeKind
    begin: int
    end: int
    size: float = 1.0
    z: float = 0.0
    is_event: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class RunShapes:
    """One run's responses to each kind of shape, by the row in which it begins.

    unit : [N, J], element j that of the row j steps later, to size 1 for one row (a jump: from there on)
    information : [N, L], of shapes of 1 .. L rows; 0 past the end
    """

    unit: dict[ShapeKind, Floats]
    information: dict[ShapeKind, Floats]

    def response(self, shape: EventShape) -> Floats:
        """White innovations that a shape of its size causes, [N]."""
        unit = self.unit[shape.kind]
        rows, lags = unit.shape
        found = np.zeros(rows + lags)
        for row in range(shape.begin, shape.end):
            found[row : row + lags] += unit[row]
        return shape.size * found[:rows]

    def scores(self, kind: ShapeKind, innovations: Floats) -> tuple[Floats, Floats]:
        """Return z and size of shapes that begin with each row, for 1 .. L rows, [N, L]; 0 past the end."""
        unit, information = self.unit[kind], self.information[kind]
        rows, lengths = information.shape
        lags = unit.shape[1]
        later = np.lib.stride_tricks.sliding_window_view(np.pad(innovations, (0, lags - 1)), lags)
        sums = np.append(0.0, np.cumsum(np.einsum("nj,nj->n", unit, later)))
        end = np.arange(rows)[:, None] + np.arange(1, lengths + 1)
        numerator = np.where(end <= rows, sums[np.minimum(end, rows)] - sums[:-1, None], 0.0)
        known = np.maximum(information, 1e-12)  # where a shape changes nothing, nothing is known of it
        return numerator / np.sqrt(known), numerator / known

    def largest(self, kind: ShapeKind, innovations: Floats) -> EventShape:
        """Return the shape that explains most."""
        z, size = self.scores(kind, innovations)
        place = begin, longer = np.unravel_index(int(np.abs(z).argmax()), z.shape)
        return EventShape(kind, int(begin), int(begin + longer) + 1, float(size[place]), float(z[place]))


def shapes_of(steps: Steps, way: InnovationGain, excess_k: Floats) -> list[RunShapes]:
    """Return the shapes of each of B runs. excess_k : T - T_amb that a door lets out, [B, N]"""
    doors = _responses(steps, way, steps.matrix[..., -1])
    doors *= -excess_k[:, :, None]
    found = []
    for own in zip(doors, _spikes(steps, way), _responses(steps, way, steps.matrix[..., -2]), strict=True):
        unit = dict(zip(LONGEST, own, strict=True))
        found.append(RunShapes(unit, {kind: _information(unit[kind], LONGEST[kind]) for kind in unit}))
    return found


def _information(unit: Floats, lengths: int) -> Floats:
    rows, lags = unit.shape
    whole, found = np.zeros((rows, lags + lengths - 1)), np.zeros((rows, lengths))
    for longer in range(min(lengths, rows)):
        reach = rows - longer
        whole[:reach, longer : longer + lags] += unit[longer:]
        found[:reach, longer] = np.einsum("nj,nj->n", whole[:reach], whole[:reach])
    return found


def _spikes(steps: Steps, way: InnovationGain) -> Floats:
    """Return the responses to a reading after step i that alone is 1 K too high."""
    later = -np.einsum("kbij,kbj->kbi", steps.matrix[1:], way.gain[:-1])
    found = _responses(steps, way, np.concatenate([np.zeros_like(way.gain[:1]), later]))
    # In place, as a second array of this size is what a small machine lacks.
    for run in found:
        run[:-1, 1:] = run[1:, :-1]
    found[:, -1, 1:] = 0.0
    found[:, :, 0] = _scale(way, np.ones_like(way.innovation), 0).T
    return found


def _responses(steps: Steps, way: InnovationGain, state: Floats) -> Floats:
    """Return white innovations, [B, N, J].

    state : [N, B, m], by how much the row's state after step i is off what the filter expects
    """
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


def _scale(way: InnovationGain, shown: Floats, lag: int) -> Floats:
    measured = np.isfinite(way.innovation[lag:])
    return np.where(measured, shown / np.sqrt(way.variance[lag:]), 0.0)
