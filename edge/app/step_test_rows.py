"""Rows of the step tests that a fit may use: without those in which hands were in the box.

A pause leaves a gap in the run's times. So does a power cut, where a later recording is joined. What the box
had stored is not known behind a gap, so each stretch between two gaps is a recording of its own.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.messages import TickRecord
from edge.formats.run_file import RecordedRun, cut
from edge.storage.runs import export_run
from edge.tick.status import LoopStatus

Floats = NDArray[np.float64]
GRACE_S = 60.0  # after the end of a pause, for a lid that is still open
SPLIT_S = 60.0  # a longer gap begins a new stretch; a pause leaves GRACE_S and two steps at least
JOIN_S = 3600.0  # between two recordings whose clocks do not tell how far they are apart
LEAST_ROWS = 30  # of a stretch: a shorter one tells little but its own start
LEARN_MIN = 15.0  # that a fit needs
PAUSES, STOPPED = "pauses_s", "stopped"  # facts of the run


@dataclass(slots=True)
class StepTestCourse:
    """Ticks of the tests so far.

    pauses : begin and end of each [s since the first tick], with the grace behind it
    rows : ticks that no pause takes out
    """

    first: TickRecord | None = None
    last: TickRecord | None = None
    pauses: list[tuple[float, float]] = field(default_factory=list)
    rows: int = 0

    def take(self, tick: TickRecord, has_hands: bool) -> None:
        """One more tick."""
        self.first, self.last = self.first or tick, tick
        time_s = tick.time_s - self.first.time_s
        is_paused = bool(self.pauses) and self.pauses[-1][1] == math.inf
        if has_hands and not is_paused:
            self.pauses.append((time_s, math.inf))
        if is_paused and not has_hands:
            self.pauses[-1] = (self.pauses[-1][0], time_s + GRACE_S)
        self.rows += not has_hands and (not self.pauses or time_s >= self.pauses[-1][1])

    def run(self, history: str | Path, stopped: str = "") -> RecordedRun:
        """Return what the history holds so far, without the pauses. Errors: DataError where it is nothing"""
        assert self.first is not None and self.last is not None
        run = export_run(history, first_seq=self.first.seq, last_seq=self.last.seq)
        time_s = run.columns["time_s"]
        slack_s = 0.5 * self.first.step_s  # ticks come a little late, the run's times are those of the grid
        is_used = np.ones(len(run), dtype=bool)
        for begin_s, end_s in self.pauses:
            is_used &= ~((time_s > begin_s - slack_s) & (time_s < end_s - slack_s))
        facts = {**run.facts, **({STOPPED: stopped} if stopped else {})}
        if self.pauses:
            facts[PAUSES] = ", ".join(f"{begin_s:.0f}..{end_s:.0f}" for begin_s, end_s in self.pauses)
        # No controller followed the reference.
        used = {key: values[is_used] for key, values in run.columns.items() if key != "reference_c"}
        return replace(run, columns=used, facts=facts)


def stop_reason(status: LoopStatus) -> str:
    """Return what ends the tests for good, "" while nothing does; maintenance is only a pause."""
    if status.operation.emergency_stop:
        return "emergency stop"
    if status.trips:
        return f"tripped: {', '.join(status.trips)}"
    echo = status.echo
    if echo is not None and echo.tripped and echo.trip_cause != "maintenance":
        return f"the board has tripped: {echo.trip_cause}"
    return ""


def join(before: RecordedRun, after: RecordedRun) -> RecordedRun:
    """Return both recordings as one run with a gap between them."""
    ended_s = float(before.columns["time_s"][-1])
    apart_s = ended_s + JOIN_S
    if before.start_utc is not None and after.start_utc is not None:
        by_clock_s = after.start_utc - before.start_utc
        apart_s = by_clock_s if by_clock_s > ended_s + SPLIT_S else apart_s
    shifted = {**after.columns, "time_s": after.columns["time_s"] + apart_s}
    columns = {
        key: np.concatenate([_column(before.columns, key, before), _column(shifted, key, after)])
        for key in {**before.columns, **after.columns}
    }
    # Neither a reason to stop of the first nor its word that a column is missing holds for both.
    kept = {key: fact for key, fact in before.facts.items() if key != STOPPED and key not in columns}
    return replace(before, columns=columns, facts={**kept, **_own(after, STOPPED)})


def _column(columns: Mapping[str, Floats], key: str, run: RecordedRun) -> Floats:
    return columns.get(key, np.full(len(run), np.nan))


def _own(run: RecordedRun, key: str) -> dict[str, str]:
    return {key: run.facts[key]} if key in run.facts else {}


def stretches(run: RecordedRun) -> list[RecordedRun]:
    """Return the run in parts without gaps, as far as they are long enough; the whole run where none is."""
    gaps = np.flatnonzero(np.diff(run.columns["time_s"]) > SPLIT_S) + 1
    parts = [cut(run, begin, end) for begin, end in pairwise([0, *gaps.tolist(), len(run)])]
    return [part for part in parts if len(part) >= LEAST_ROWS] or [run]
