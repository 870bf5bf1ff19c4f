"""Doors that were opened: short heat towards the ambient that no input explains, when, and for how much of
a step.

At every row a door, a wrong reading and a heat that stays are weighed against each other, and the one that
explains most is taken out, until none is left that chance would not bring: matching pursuit with a threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.candidates import EventShape, RunShapes, ShapeScores, jumps, pulses, spikes, white
from edge.diagnosis.locate.residual_heat import HeatFilterResult, Steps, filter_heat, likeliest, steps_of
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
SURE_SDS = 3.0  # above 0 that a row beside a door must be to belong to it, and
HALF_OPEN = 0.7  # times the usual door's conductance, below which one is not as wide open
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


Kinds = NDArray[np.intp]
OFFSETS = (-1, 0, 1, 2)  # rows from a change to where what it does may seem to begin
FEWEST = 6  # changes of a kind, below which one cannot tell what is usual after them
FIRST_ROWS = 3  # of a run, in which a wrong start looks like an event
# Share of the rows by which the usual z² is told, and that of a normal variable. Events themselves may be in
# half of the rows; few are just at a change, but perhaps only some changes do something that is not known.
ANYWHERE, AT_CHANGE = (0.3, 0.1485), (0.8, 1.6424)


@dataclass(frozen=True, slots=True, eq=False)
class Switches:
    """kind : [B, N + 1], 0 where no input has just changed, else a number per input, direction and offset."""

    kind: Kinds

    @classmethod
    def of(cls, runs: RunBatch) -> "Switches":
        """Return the switches of heater, fan and light."""
        count, rows = runs.duty.shape
        kind = np.zeros((count, rows + 1), dtype=np.intp)
        light = [runs.conditions["light"]] if "light" in runs.conditions else []
        number = 1
        for values in (runs.duty, runs.fan, *light):
            change = np.diff(values, axis=1, prepend=values[:, :1])
            for changed in (change > 0.0, change < 0.0):
                for offset in OFFSETS:
                    places = np.argwhere(changed) + np.array([0, offset])
                    inside = (places[:, 1] >= 0) & (places[:, 1] <= rows)
                    kind[places[inside, 0], places[inside, 1]] = number
                    number += 1
        return cls(kind)

    def usual(self, z: Floats) -> Floats:
        """Usual size of z where a thing begins or ends like this, 1 at least; infinite where none can tell.

        z, returned : [B, N, L], by where an event begins and how long it is
        """
        rows, lengths = z.shape[1:]
        begins, by_end = _by_kind(self.kind[:, :-1], z), np.zeros((len(z), rows + 1, lengths))
        for length in range(1, min(lengths, rows) + 1):
            by_end[:, length:, length - 1] = z[:, : rows - length + 1, length - 1]
        ends = _by_kind(self.kind, by_end)
        for length in range(1, min(lengths, rows) + 1):
            here = begins[:, : rows - length + 1, length - 1]
            np.maximum(here, ends[:, length:, length - 1], out=here)
        begins[:, :FIRST_ROWS] = np.inf
        return begins


def _by_kind(kind: Kinds, z: Floats) -> Floats:
    """kind : [B, N]; z, returned : [B, N, L]."""
    found = np.ones_like(z)
    for number in np.unique(kind):
        here = kind == number
        share, normal = AT_CHANGE if number else ANYWHERE
        squares = np.sort(z[here] ** 2, axis=0)
        size = np.sqrt(squares[int(share * len(squares))] / normal)
        found[here] = np.maximum(size, 1.0) if number == 0 or here.sum() >= FEWEST else np.inf
    return found


Mask = NDArray[np.bool_]
FALSE_ALARM = 0.01  # per run, in noise alone
INDEPENDENT = 6.0  # lengths of a door that are tried, as if they had nothing in common
MARGIN_NATS = 2.0  # by which a door must explain more than a wrong reading or a heat that stays
PASSES = 3  # noise levels are chosen anew without the rows of the doors found
MOST_SHAPES = 60  # in a run
ALONE_ROWS = 3


@dataclass(frozen=True, slots=True)
class DoorOpening:
    """A door that was open during rows [from_row, to_row) of a run.

    shares : of each of those steps, 0..1; heat_w : mean residual heat in them, below 0 when heat is lost
    conductance_w_k : towards the room while open; z : standard deviations above none
    """

    run: str
    from_row: int
    to_row: int
    from_s: float
    to_s: float
    shares: tuple[float, ...]
    heat_w: float
    conductance_w_k: float
    z: float


@dataclass(frozen=True, slots=True, eq=False)
class LocatedEvents:
    """door_open : [B, N], 0..1, a column that a twin's `door_opening` takes; wrong : [B, N + 1], readings."""

    doors: tuple[DoorOpening, ...]
    door_open: Floats
    wrong: Mask


def find_events(
    twin: BoxTwin,
    runs: RunBatch,
    names: Sequence[str],
    sensor_k: float | None = None,
    false_alarm: float = FALSE_ALARM,
) -> LocatedEvents:
    """Doors and wrong readings in B runs.

    names : of the runs; sensor_k : sd of a measured temperature [K], the twin's own where None
    false_alarm : chance of a door in a run without any, for a right twin and Gaussian noise
    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    sensor_k = twin.noise.sensor_k if sensor_k is None else sensor_k
    steps = steps_of(twin, runs, sensor_k)
    found: list[list[EventShape]] = [[] for _ in names]
    switches = Switches.of(runs)
    shapes: list[RunShapes] = []
    for _ in range(PASSES):
        # Found events loosen the filter where they are, so that the next pass does not see them as noise.
        way = filter_heat(steps, sensor_k, likeliest(_loosen(steps, found), sensor_k))
        shapes.clear()  # the largest arrays of a diagnosis: never two passes' at once
        shapes = _shapes(twin, runs, steps, way)
        before, found = found, _pursue(shapes, white(way), switches, false_alarm)
        if _places(before) == _places(found):
            break
    return _located_events(runs, names, twin.step_s, shapes, white(way), found)


def _places(found: list[list[EventShape]]) -> list[list[tuple[str, int, int]]]:
    return [[shape[:3] for shape in part] for part in found]


def _loosen(steps: Steps, found: list[list[EventShape]]) -> Steps:
    """Return the steps without the events: doors may bring any heat, wrong readings count as missing."""
    loose, temp = steps.loose.copy(), steps.temp.copy()
    for i, part in enumerate(found):
        for shape in part:
            if shape.kind == "spike":
                temp[shape.begin, i] = np.nan
            else:
                loose[shape.begin : shape.end, i] = True
    return replace(steps, loose=loose, temp=temp)


def _shapes(twin: BoxTwin, runs: RunBatch, steps: Steps, way: HeatFilterResult) -> list[RunShapes]:
    # As measured at the end of each step: a filter that expects no door lags behind one, and warm air that a
    # door lets out is gone in seconds.
    shown = np.stack([hold(temp) for temp in runs.temp])[:, 1:]
    excess = shown - twin.signals.room(runs.ambient)
    doors = pulses(steps, way)
    doors *= -excess[:, :, None]
    every = zip(doors, spikes(steps, way), jumps(steps, way), excess, strict=True)
    return [RunShapes(*parts) for parts in every]


def _pursue(
    shapes: list[RunShapes], innovations: Floats, switches: Switches, false_alarm: float
) -> list[list[EventShape]]:
    from scipy.special import ndtri  # the normal quantile; scipy.stats takes a second to load

    threshold = -float(ndtri(false_alarm / (INDEPENDENT * innovations.shape[1])))
    parts = list(zip(shapes, innovations, strict=True))
    usual = {
        "door": switches.usual(np.stack([run.doors(row).z for run, row in parts])),
        "spike": switches.usual(np.stack([run.spikes(row).z for run, row in parts])),
        "jump": switches.usual(np.stack([run.jumps(row).z for run, row in parts])),
    }
    found = []
    for i, (run, row) in enumerate(parts):
        left = row.copy()
        part: list[EventShape] = []
        sizes = {kind: size[i] for kind, size in usual.items()}
        while len(part) < MOST_SHAPES and (best := _best(run, left, sizes, threshold)):
            part.append(best)
            left -= best.size * run.response(best)
        found.append(part)
    return found


def _best(
    run: RunShapes, innovations: Floats, usual: dict[str, Floats], threshold: float
) -> EventShape | None:
    """Return the shape that explains most, None if no shape exceeds the usual by the threshold."""
    door = _largest("door", run.doors(innovations))
    spike, jump = _largest("spike", run.spikes(innovations)), _largest("jump", run.jumps(innovations))
    rival = max(spike, jump, key=lambda shape: abs(shape.z))
    best = door if 0.5 * door.z**2 > 0.5 * rival.z**2 + MARGIN_NATS else rival
    within = usual[best.kind][:, best.end - best.begin - 1]
    if best.kind == "door" and (best.size < 0.0 or best.z < threshold * within[best.begin]):
        best = best._replace(kind="input")
    if best.kind == "spike" and abs(best.z) < threshold * within[best.begin]:
        best = best._replace(kind="late")
    return best if abs(best.z) > threshold * within.min() else None


def _largest(kind: str, found: ShapeScores) -> EventShape:
    begin, length = (int(i) for i in np.unravel_index(int(np.abs(found.z).argmax()), found.z.shape))
    return EventShape(
        kind, begin, begin + length + 1, float(found.size[begin, length]), float(found.z[begin, length])
    )


def _located_events(
    runs: RunBatch,
    names: Sequence[str],
    step_s: float,
    shapes: list[RunShapes],
    innovations: Floats,
    found: list[list[EventShape]],
) -> LocatedEvents:
    wrong = np.zeros(runs.temp.shape, dtype=bool)
    every: list[list[Opening]] = []
    for i, (run, part) in enumerate(zip(shapes, found, strict=True)):
        wrong[i, [shape.begin + 1 for shape in part if _stands_alone(shape, part)]] = True
        doors = merge([shape for shape in part if shape.kind == "door"])
        others = [shape for shape in part if shape.kind != "door" and not _touches(shape, doors)]
        left = innovations[i] - sum((s.size * run.response(s) for s in others), start=np.zeros(()))
        every.append(openings(run, left, doors))
    # A short opening does not tell how wide it was; the usual long one does. Slow errors behind an opening
    # look like more of them, hardly open.
    usual = _usual_w_k([item for part in every for item in part if is_long(item)])
    door_open, told = np.zeros_like(runs.duty), []
    for i, (name, found_here) in enumerate(zip(names, every, strict=True)):
        for item in found_here:
            full = full_w_k(item) if is_long(item) else max(full_w_k(item), usual)
            if full <= SMALLEST * usual:
                continue  # beside the usual door's conductance it is none
            share = shares(item, full) * (full / usual if full < HALF_OPEN * usual else 1.0)
            share[share < SMALLEST] = 0.0
            if not (share > 0.0).any():
                continue
            rows = slice(item.begin, item.begin + len(share))
            door_open[i, rows] = np.maximum(door_open[i, rows], share)
            told.append(_door(name, step_s, item, share, full, shapes[i].excess))
    return LocatedEvents(tuple(told), door_open, wrong)


def _usual_w_k(doors: Sequence[Opening]) -> float:
    """Return the median conductance, weighted by what each door explains; 0 without any."""
    if not doors:
        return 0.0
    wide, explained = (
        np.array(own) for own in zip(*((full_w_k(d), d.shape.z**2) for d in doors), strict=True)
    )
    order = np.argsort(wide)
    half = 0.5 * explained.sum()
    return float(wide[order][np.searchsorted(np.cumsum(explained[order]), half)])


def _touches(shape: EventShape, doors: list[EventShape]) -> bool:
    """Return whether a shape is part of a door's effect, which a constant conductance did not fit."""
    return any(shape.begin <= door.end and door.begin <= shape.end for door in doors)


def _stands_alone(spike: EventShape, every: list[EventShape]) -> bool:
    """Return whether a wrong reading stands alone. Next to another event, a
    spike is that event's remainder.
    """
    others = (shape for shape in every if shape is not spike)
    return spike.kind == "spike" and all(
        shape.end + ALONE_ROWS < spike.begin or spike.end + ALONE_ROWS < shape.begin for shape in others
    )


def _door(name: str, step_s: float, item: Opening, share: Floats, full: float, excess: Floats) -> DoorOpening:
    rows = np.flatnonzero(share > 0.0)
    first, last = int(rows[0]), int(rows[-1])
    begin, end = item.begin + first, item.begin + last + 1
    heat_w = -item.conductance_w_k[first : last + 1] * excess[begin:end]
    shown = tuple(float(value) for value in share[first : last + 1])
    return DoorOpening(
        name, begin, end, begin * step_s, end * step_s, shown, float(heat_w.mean()), full, item.shape.z
    )
