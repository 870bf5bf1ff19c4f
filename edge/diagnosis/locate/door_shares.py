"""For how much of each step a door was open, once it is known about when."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.candidates import EventShape, RunShapes

Floats = NDArray[np.float64]
SURE_SDS = 3.0  # above 0 that a row beside a door must be to belong to it, and
SMALLEST = 0.2  # share of the step
LONG = 3  # rows of a door whose inner ones tell how wide it was open


class Opening(NamedTuple):
    """conductance_w_k : of rows [begin, begin + L) and a row on either side, [L]; sd_w_k : its sd"""

    begin: int
    conductance_w_k: Floats
    sd_w_k: Floats
    shape: EventShape


def merge(doors: list[EventShape]) -> list[EventShape]:
    """Doors in order, those that touch or overlap as one."""
    found: list[EventShape] = []
    for door in sorted(doors, key=lambda shape: shape.begin):
        if found and door.begin <= found[-1].end:
            last = max(found[-1], door, key=lambda shape: shape.z)
            end = max(found[-1].end, door.end)
            found[-1] = last._replace(begin=found[-1].begin, end=end)
        else:
            found.append(door)
    return found


def openings(run: RunShapes, innovations: Floats, doors: list[EventShape]) -> list[Opening]:
    """Each door's conductance row by row, by least squares beside the other doors.

    innovations : [N], white, wrong readings and jumps taken out
    """
    found = []
    for door in doors:
        left = innovations - sum(
            (other.size * run.response(other) for other in doors if other is not door), start=np.zeros(())
        )
        begin, end = max(door.begin - 1, 0), min(door.end + 1, len(left))
        columns = np.stack([run.response(EventShape("door", i, i + 1, 1.0, 0.0)) for i in range(begin, end)])
        normal = columns @ columns.T + 1e-9 * np.eye(end - begin)
        sizes = np.linalg.solve(normal, columns @ left)
        sds = np.sqrt(np.diag(np.linalg.inv(normal)))
        found.append(Opening(begin, sizes.astype(np.float64), sds.astype(np.float64), door))
    return found


def full_w_k(opening: Opening) -> float:
    """How wide it was: the median of its inner rows, or the most of its rows where it was short."""
    rows = _own(opening)
    return float(np.median(rows[1:-1]) if len(rows) >= LONG else rows.max())


def is_long(opening: Opening) -> bool:
    """Return whether an opening has inner rows."""
    return len(_own(opening)) >= LONG


def shares(opening: Opening, full: float) -> Floats:
    """Return the share of each row, 0..1, for a door of `full` W/K: inner rows whole, both ends in part."""
    part = np.clip(opening.conductance_w_k / full, 0.0, 1.0)
    place = np.arange(len(part)) + opening.begin
    inner = (place > opening.shape.begin) & (place < opening.shape.end - 1)
    outer = (place < opening.shape.begin) | (place >= opening.shape.end)
    unsure = (opening.conductance_w_k < SURE_SDS * opening.sd_w_k) | (part < SMALLEST)
    return np.where(inner, 1.0, np.where(outer & unsure, 0.0, part))


def _own(opening: Opening) -> Floats:
    first = opening.shape.begin - opening.begin
    return opening.conductance_w_k[first : first + opening.shape.end - opening.shape.begin]
