"""Doors that were opened: short heat towards the ambient that no input explains, when, and for how much of
a step.

At every row a door, a wrong reading and a heat that stays are weighed against each other, and the one that
explains most is taken out, until no shape is left that chance would not bring: matching pursuit with a
threshold.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.heat_filter import Steps, filter_heat, likeliest, steps_of, white
from edge.diagnosis.locate.shapes import LONGEST, EventShape, RunShapes, ShapeKind, shapes_of
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
Kinds = NDArray[np.intp]
Mask = NDArray[np.bool_]
FALSE_ALARM = 0.01  # per run, in noise alone
INDEPENDENT = 6.0  # lengths of a door that are tried, as if they had nothing in common
MARGIN_NATS = 2.0  # by which a door must explain more than a wrong reading or a heat that stays
PASSES = 3  # noise levels are chosen again without the rows of the doors found
MOST_SHAPES = 60  # in a run
ALONE_ROWS = 3  # between a wrong reading and any other shape; next to one, a spike is that one's remainder
OFFSETS = (-1, 0, 1, 2)  # rows from a change to where its effect may seem to begin
FEWEST = 6  # changes of a kind, below which no size is usual after them
FIRST_ROWS = 3  # of a run, in which a wrong start looks like an event
# Share of the rows that shows the usual |z|, and that quantile of a normal variable's. Events themselves may
# be in half of the rows; few are just at a change, but perhaps only some changes do something unknown.
ANYWHERE, AT_CHANGE = (0.3, 0.3853), (0.8, 1.2816)
LONG = 3  # rows of a door whose inner ones show how wide it was open
SURE_SDS = 3.0  # above 0 that a row next to a door must be to belong to it
SMALLEST = 0.2  # share of a step
HALF_OPEN = 0.7  # times the usual door's conductance, below which one is not as wide open


@dataclass(frozen=True, slots=True)
class DoorOpening:
    """A door that was open for a while, in time since a run's first row.

    heat_w : mean residual heat meanwhile, below 0 when heat is lost
    conductance_w_k : towards the room while it was widest open
    """

    run: str
    from_s: float
    to_s: float
    heat_w: float
    conductance_w_k: float


@dataclass(frozen=True, slots=True, eq=False)
class LocatedEvents:
    """door_open : [B, N], 0..1, a column that a twin's `door_opening` takes; wrong : [B, N + 1], readings."""

    doors: tuple[DoorOpening, ...]
    door_open: Floats
    wrong: Mask


def find_events(twin: BoxTwin, runs: RunBatch, names: Sequence[str], sensor_k: float) -> LocatedEvents:
    """Doors and wrong readings in B runs.

    names : of the runs; sensor_k : sd of a measured temperature [K]
    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    steps, changes = steps_of(twin, runs, sensor_k), _changes(runs)
    # As measured at the end of each step: a filter that expects no door lags behind one, and warm air that a
    # door lets out is gone in seconds.
    excess_k = np.stack([hold(temp) for temp in runs.temp])[:, 1:] - twin.signals.room(runs.ambient)
    found: list[list[EventShape]] = [[] for _ in names]
    shapes: list[RunShapes] = []
    for _ in range(PASSES):
        # Found events loosen the filter where they are, so that the next pass does not see them as noise.
        way = filter_heat(steps, sensor_k, likeliest(_loosen(steps, found), sensor_k))
        innovations = np.nan_to_num(white(way))
        shapes.clear()  # the largest arrays of a diagnosis: never two passes' at once
        shapes = shapes_of(steps, way, excess_k)
        before, found = found, _pursue(shapes, innovations, changes)
        if [[shape[:3] for shape in part] for part in before] == [[s[:3] for s in part] for part in found]:
            break
    wrong = np.zeros(runs.temp.shape, dtype=bool)
    for i, part in enumerate(found):
        spikes = (shape for shape in part if shape.kind == "spike" and shape.is_event)
        wrong[i, [spike.begin + 1 for spike in spikes if not _is_near(spike, part, ALONE_ROWS)]] = True
    opened = [_opened_rows(*parts) for parts in zip(shapes, innovations, found, strict=True)]
    usual, door_open = _shares(opened)
    power_w, doors = twin.geometry.heater_max_w, []
    for i, (name, run) in enumerate(zip(names, opened, strict=True)):
        for begin, end in _spans(door_open[i] > 0.0):
            heat_w = -power_w * float((run.conductance * excess_k[i])[begin:end].mean())
            widest = usual * float(door_open[i, begin:end].max())
            at_s = begin * twin.step_s, end * twin.step_s
            doors.append(DoorOpening(name, *at_s, heat_w, power_w * widest))
    return LocatedEvents(tuple(doors), door_open, wrong)


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


def _changes(runs: RunBatch) -> Kinds:
    """0 where no input has just changed, else a number per input, direction and offset, [B, N + 1]."""
    light = runs.conditions.get("light", np.zeros_like(runs.duty))
    found, number = np.zeros(runs.temp.shape, dtype=np.intp), 0
    for values in (runs.duty, runs.fan, light):
        change = np.pad(np.diff(values, axis=1), ((0, 0), (1, 1)))
        for changed in (change > 0.0, change < 0.0):
            for offset in OFFSETS:
                number += 1
                # What comes round from a run's end is in its FIRST_ROWS, in which no event is looked for.
                found[np.roll(changed, offset, axis=1)] = number
    return found


def _usual(changes: Kinds, z: Floats) -> Floats:
    """Usual size of z where a thing begins or ends like this, 1 at least; infinite where unknown.

    z, returned : [B, N, L], by where an event begins and how long it is
    """
    found = np.full_like(z, np.inf)
    for longer in range(min(z.shape[1:])):
        reach = z.shape[1] - longer
        own, usual = np.abs(z[:, :reach, longer]), found[:, :reach, longer]
        usual[:] = 1.0
        for kinds in (changes[:, :reach], changes[:, longer + 1 :]):
            for number in np.unique(kinds):
                here = kinds == number
                sizes = np.sort(own[here])
                share, normal = AT_CHANGE if number else ANYWHERE
                is_known = number == 0 or len(sizes) >= FEWEST
                size = sizes[int(share * len(sizes))] / normal if is_known else np.inf
                usual[here] = np.maximum(usual[here], size)
    found[:, :FIRST_ROWS] = np.inf
    return found


def _pursue(shapes: list[RunShapes], innovations: Floats, changes: Kinds) -> list[list[EventShape]]:
    from scipy.special import ndtri  # the normal quantile; scipy.stats takes a second to load

    threshold = -float(ndtri(FALSE_ALARM / (INDEPENDENT * innovations.shape[1])))
    parts = list(zip(shapes, innovations.copy(), strict=True))
    needed = {
        kind: threshold * _usual(changes, np.stack([run.scores(kind, left)[0] for run, left in parts]))
        for kind in LONGEST
    }
    found: list[list[EventShape]] = []
    for i, (run, left) in enumerate(parts):
        found.append([])
        own = {kind: size[i] for kind, size in needed.items()}
        while len(found[i]) < MOST_SHAPES and (best := _best(run, left, own)):
            found[i].append(best)
            left -= run.response(best)
    return found


def _best(run: RunShapes, innovations: Floats, needed: dict[ShapeKind, Floats]) -> EventShape | None:
    """Return the shape that explains most, None if it is what chance may bring where no input changes."""
    door, spike, jump = (run.largest(kind, innovations) for kind in needed)
    # Rounded: in the last row a wrong reading and a jump are the same, and it counts as the former.
    rival = max(spike, jump, key=lambda shape: round(abs(shape.z), 6))
    best = door if 0.5 * door.z**2 > 0.5 * rival.z**2 + MARGIN_NATS else rival
    least = needed[best.kind][:, best.end - best.begin - 1]
    if not abs(best.z) > least.min():
        return None
    is_loss = best.kind != "door" or best.size > 0.0
    return best._replace(is_event=is_loss and abs(best.z) >= least[best.begin])


def _is_near(shape: EventShape, others: Iterable[EventShape], rows: int) -> bool:
    return any(
        shape.begin <= other.end + rows and other.begin <= shape.end + rows
        for other in others
        if other is not shape
    )


class _OpenedRows(NamedTuple):
    """Rows of a run in which a door was open, and what their conductance seems to be, with its sd, [N].

    Conductances are shares of the heater's power per K; 0 further than a row from any door.
    """

    is_open: Mask
    conductance: Floats
    sd: Floats


def _opened_rows(run: RunShapes, innovations: Floats, part: list[EventShape]) -> _OpenedRows:
    """Fit the conductance of each row in and next to a door, all of a run's together, by least squares."""
    doors = [shape for shape in part if shape.kind == "door" and shape.is_event]
    # A shape that touches a door is part of its effect, which a constant conductance did not fit.
    others = [shape for shape in part if shape not in doors and not _is_near(shape, doors, 0)]
    left = innovations - sum((run.response(shape) for shape in others), start=np.zeros(()))
    is_open, conductance, sd = np.zeros(len(left), dtype=bool), np.zeros(len(left)), np.ones(len(left))
    for shape in doors:
        is_open[shape.begin : shape.end] = True
    rows = np.flatnonzero(np.convolve(is_open, np.ones(3), "same"))
    if len(rows):
        columns = np.stack([run.response(EventShape("door", row, row + 1)) for row in rows.tolist()])
        normal = columns @ columns.T
        inverse = np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(len(rows)))
        conductance[rows], sd[rows] = inverse @ columns @ left, np.sqrt(np.diag(inverse))
    return _OpenedRows(is_open, conductance, sd)


def _shares(opened: list[_OpenedRows]) -> tuple[float, Floats]:
    """Return the usual door's conductance, and the share of each row that one was open for, 0..1, [B, N]."""
    every = [run.conductance[begin:end] for run in opened for begin, end in _spans(run.is_open)]
    # A short opening does not show how wide it was; the usual long one does.
    shown = [own[1:-1] for own in every if len(own) >= LONG] or [own.max(keepdims=True) for own in every]
    usual = float(np.median(np.concatenate(shown))) if shown else np.inf
    found = []
    for is_open, conductance, sd in opened:
        share = np.clip(conductance / usual, 0.0, 1.0)
        for begin, end in _spans(is_open):
            if end - begin >= LONG:  # both ends in part, the rows between them alike
                wide = float(np.median(conductance[begin + 1 : end - 1])) / usual
                share[begin + 1 : end - 1] = 1.0 if wide > HALF_OPEN else wide
        # Slow errors behind an opening look like more of it, hardly open.
        is_sure = (share > SMALLEST) & (is_open | (conductance > SURE_SDS * sd))
        found.append(np.where(is_sure, share, 0.0))
    return usual, np.stack(found)


def _spans(mask: Mask) -> list[tuple[int, int]]:
    """Return where a mask is true, as rows [begin, end)."""
    edges = np.flatnonzero(np.diff(mask.astype(int), prepend=0, append=0)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
