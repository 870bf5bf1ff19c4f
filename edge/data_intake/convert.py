"""A log by its mapping as run files, split where rows are missing."""

from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.plain_text import plain, quote
from edge.data_intake.cells import Cells, is_missing, number, read_cells
from edge.data_intake.mapping import LogMap, Source
from edge.data_intake.times import read_times
from edge.data_intake.units import INPUTS, SHARES, UNITS, truth
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.formats.run_lines import ABSENT

Floats = NDArray[np.float64]
FEWEST_ROWS = 2
OVER = 1e-6  # beyond 0..1 that is rounding
DIGITS = 9


def convert(path: Path, mapping: LogMap, out: Path) -> list[tuple[Path, int]]:
    """Write `OUT/NAME_01.csv`, ...; each with its rows.

    Errors : DataError naming file, line and column; OSError where nothing can be written
    """
    cells = read_cells(path, None if mapping.layout.encoding == "xlsx" else mapping.layout)
    time_s, absolute = _times(cells, mapping)
    keep = _rows_to_keep(cells, mapping, time_s)
    columns = {target: _values(cells, target, source)[keep] for target, source in mapping.columns.items()}
    time_s = time_s[keep]
    for target in INPUTS:
        if target in columns:
            columns[target] = _hold(cells, mapping.columns[target].column, columns[target])
    breaks = (np.flatnonzero(np.diff(time_s) > mapping.gap_s) + 1).tolist()
    pieces = [piece for piece in pairwise([0, *breaks, len(time_s)]) if piece[1] - piece[0] >= FEWEST_ROWS]
    if not pieces:
        raise DataError(f"{path}: no two rows are within time.gap_s, {mapping.gap_s:g} s")
    written = []
    for i, (begin, end) in enumerate(pieces, start=1):
        place = out / f"{path.stem}_{i:02d}.csv"
        run = _run(path, mapping, time_s[begin:end], {k: v[begin:end] for k, v in columns.items()}, absolute)
        write_run(run, place)
        read_run(place)  # what the commands that follow would refuse is refused now
        written.append((place, end - begin))
    return written


def _times(cells: Cells, mapping: LogMap) -> tuple[Floats, bool]:
    if not mapping.time:
        assert mapping.period_s is not None
        return mapping.period_s * np.arange(len(cells.rows), dtype=np.float64), False
    return read_times(cells, mapping.time, mapping.time_format, mapping.zone)


def _rows_to_keep(cells: Cells, mapping: LogMap, time_s: Floats) -> NDArray[np.intp]:
    """Rows without those that repeat a time. Errors: DataError for time that goes backwards"""
    steps = np.diff(time_s)
    if (steps < 0.0).any():
        row = int((steps < 0.0).argmax()) + 1
        raise DataError(f"{cells.place(row, mapping.time)}: time goes backwards")
    twice = np.flatnonzero(steps == 0.0)
    if len(twice) and mapping.repeated == "refuse":
        raise DataError(
            f"{cells.place(int(twice[0]) + 1, mapping.time)}: this time stands there twice; "
            "`time.repeated: first` or `last` in the mapping says which row counts"
        )
    gone = twice + 1 if mapping.repeated == "first" else twice
    return np.setdiff1d(np.arange(len(time_s)), gone)


def _values(cells: Cells, target: str, source: Source) -> Floats:
    raw = np.full(len(cells.rows), np.nan)
    for i, cell in enumerate(cells.column(source.column)):
        if is_missing(cell):
            continue
        value = truth(cell) if source.unit == "on/off" else None
        value = number(cell, cells.layout.decimal) if value is None else value
        value = truth(cell) if value is None else value
        if value is None:
            raise DataError(f"{cells.place(i, source.column)}: {quote(cell)} is no number")
        raw[i] = value
    values = np.round(UNITS[source.unit].to_ours(raw, source.full or 1.0), DIGITS)
    if target in SHARES:
        bad = (values < -OVER) | (values > 1.0 + OVER)
        if bad.any():
            row = int(bad.argmax())
            raise DataError(
                f"{cells.place(row, source.column)}: {raw[row]:g} as `{source.unit}` is {values[row]:g}, not "
                f"within 0..1: is columns.{target}.unit right?"
            )
        values = np.clip(values, 0.0, 1.0)
    return np.asarray(values)


def _hold(cells: Cells, column: str, values: Floats) -> Floats:
    """Return an input that holds until its next value. Errors: DataError where its first value is missing"""
    known = np.isfinite(values)
    if not known[0]:
        raise DataError(f"{cells.place(0, column)}: empty in the first row; an input must be known")
    return values[np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))]


def _run(
    path: Path, mapping: LogMap, time_s: Floats, columns: Mapping[str, Floats], absolute: bool
) -> RecordedRun:
    facts = {"notes": f"from {plain(path.name, 200)}"}
    if absolute:
        facts["start_utc"] = datetime.fromtimestamp(float(time_s[0]), UTC).isoformat(timespec="milliseconds")
    facts |= dict.fromkeys((name for name in mapping.absent if name not in columns), ABSENT)
    return RecordedRun({"time_s": np.round(time_s - time_s[0], DIGITS), **columns}, facts)
