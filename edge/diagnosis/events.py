"""Doors that were opened and wrong readings: sought by the chosen twin, then known to the next fit."""

from dataclasses import replace

import numpy as np

from edge.core.errors import DataError
from edge.diagnosis.locate.events import DoorOpening, find_events
from edge.diagnosis.prepare import PreparedRuns
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.twin_fit import FittedTwin

__all__ = ["DOOR", "DoorOpening", "with_events"]
FIRST_OFF_K, FIRST_SDS = 1.5, 6.0  # of a first reading from where the run begins, to be wrong
DOOR = "door_open"  # the column that doors found in the runs become


def with_events(known: PreparedRuns, fit: FittedTwin) -> tuple[PreparedRuns, tuple[DoorOpening, ...]]:
    """Return the runs with doors as a column `door_open` and without wrong readings, and the doors."""
    runs = known.with_rooms(fit.starts)
    begun = np.where(np.isfinite(runs.temp[:, 0]), runs.temp[:, 0], fit.starts[:, 0])
    runs = replace(runs, temp=np.concatenate([begun[:, None], runs.temp[:, 1:]], axis=1))
    try:
        events = find_events(fit.file.twin(), runs, known.names, known.noise_k)
    except (DataError, np.linalg.LinAlgError):
        return known, ()  # a twin that is so far off has no events to tell
    wrong = events.wrong.copy()
    # Where a run begins its fit tells better than a reading that is far from it.
    far_k = max(FIRST_OFF_K, FIRST_SDS * fit.rmse_k)
    wrong[:, 0] = np.isfinite(known.runs.temp[:, 0]) & (np.abs(fit.starts[:, 0] - begun) > far_k)
    if not events.doors and not wrong.any():
        return known, ()
    temp = np.where(wrong, np.nan, known.runs.temp)
    clean = replace(known.runs, temp=temp)
    if events.doors:
        recorded = clean.conditions.get(DOOR, np.zeros_like(clean.duty))
        door_open = np.maximum(recorded, events.door_open)
        clean = replace(clean, conditions={**clean.conditions, DOOR: door_open})
    taken = int(np.isfinite(known.runs.temp).sum() - np.isfinite(temp).sum())
    fitted = replace(known, runs=clean, wrong=known.wrong + taken)
    train = tuple(_with_column(fitted, i, named) for i, named in enumerate(known.train))
    return replace(fitted, train=train), events.doors


def _with_column(known: PreparedRuns, i: int, named: NamedRun) -> NamedRun:
    if DOOR not in known.runs.conditions:
        return named
    columns = dict(named.run.columns)
    seen = np.flatnonzero(np.isfinite(columns["temp_air_c"]))
    first, last = int(seen[0]), int(seen[-1])
    door_open = np.zeros(len(named.run))
    door_open[first:last] = known.runs.conditions[DOOR][i, : last - first]
    return replace(named, run=replace(named.run, columns={**columns, DOOR: door_open}))
