"""Doors that were opened: short heat towards the room at times that no input tells, and back again.

At every row a door, a wrong reading and a heat that stays are weighed against each other, and the one that
explains most is taken out, until none is left that chance would not bring: matching pursuit with a threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.candidates import EventShape, RunShapes, ShapeScores
from edge.diagnosis.locate.door_shares import Opening, full_w_k, is_long, merge, openings, shares
from edge.diagnosis.locate.heat_filter import HeatFilterResult, Steps, filter_heat, steps_of
from edge.diagnosis.locate.residual_heat import likeliest
from edge.diagnosis.locate.switches import Switches
from edge.diagnosis.locate.whitening import jumps, pulses, spikes, white
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
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
    # A short opening does not tell how wide it was; the usual long one does.
    wide = [full_w_k(item) for part in every for item in part if is_long(item)]
    usual = float(np.median(wide)) if wide else 0.0
    door_open, told = np.zeros_like(runs.duty), []
    for i, (name, found_here) in enumerate(zip(names, every, strict=True)):
        for item in found_here:
            full = full_w_k(item) if is_long(item) else max(full_w_k(item), usual)
            share = shares(item, full)
            if not (share > 0.0).any():
                continue  # beside the usual door's conductance it is none
            rows = slice(item.begin, item.begin + len(share))
            door_open[i, rows] = np.maximum(door_open[i, rows], share)
            told.append(_door(name, step_s, item, share, full, shapes[i].excess))
    return LocatedEvents(tuple(told), door_open, wrong)


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
