"""Readings that cannot be right, by their units or beside their neighbours, and the expected reading."""

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.names import SIGNALS
from edge.formats.number_table import NumberTable
from edge.formats.run_file import RecordedRun, run_of
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import hold

TOLERATED = 0.1  # share of a column's numbers that may be slips of the sensor: more is another unit
WHAT = {
    "temp_air_c": "air temperature",
    "temp_air_second_c": "air temperature",
    "temp_ambient_c": "room temperature",
}
KELVIN = (200.0, 400.0)
STEP_MAX_S = 600.0  # of a run file's rows, unless the twin's step is longer: a box answers within minutes
_HUMIDITY = "rel_humidity_pct"

Floats = NDArray[np.float64]


def plausible_run(
    table: NumberTable,
    without: Collection[str] = (),
    highest_c: float | None = None,
    step_s: float = STEP_MAX_S,
) -> tuple[RecordedRun, list[str]]:
    """Return the table as a run in which every number is possible for its
    column, and sentences about what was left out.

    without : columns that the table may lack, as in `read_run`
    highest_c : that the air may have, as the twin file says; None: what greenhouses have
    step_s : of the twin: rows that far apart are no slip
    Errors : DataError naming file, line and column, and the unit that it looks like
    """
    run = run_of(table, without)
    _check_time(run, max(step_s, STEP_MAX_S))
    _check_humidity(table)
    columns, told = dict(run.columns), []
    for key in WHAT.keys() & columns.keys():
        columns[key], note = _temperatures(table, key, highest_c if WHAT[key] == "air temperature" else None)
        told += note
    return replace(run, columns=columns), told


def _check_time(run: RecordedRun, most_s: float) -> None:
    steps = np.diff(run.columns["time_s"])
    if len(steps) and (usual := float(np.median(steps))) > most_s:
        unit = "; is it in milliseconds?" if usual >= 1000.0 else ""
        raise DataError(
            f"{run.path}: time_s: rows are {usual:g} s apart, more than {most_s:g} s{unit}; a house that is "
            f"so slow says so in its twin file: sample_s: {usual:g}"
        )


def _check_humidity(table: NumberTable) -> None:
    values = table.columns.get(_HUMIDITY)
    if values is None:
        return
    table.refuse(_HUMIDITY, (values < 0.0) | (values > 100.0), "is not in 0..100 %")
    if 0.0 < np.nanmax(values, initial=0.0) <= 1.0:
        table.refuse(_HUMIDITY, values > 0.0, "is no humidity of a room in percent; is it a share of 1?")


def _temperatures(table: NumberTable, key: str, highest_c: float | None) -> tuple[Floats, list[str]]:
    """Return the column without impossible air temperatures. Errors:
    DataError where they are more than slips
    """
    signal = next(signal for signal in SIGNALS.values() if signal.key == key.replace("_second", ""))
    values = table.columns[key]
    high = signal.high if highest_c is None else highest_c
    odd = (values < signal.low) | (values > high)
    if not odd.any():
        return values, []
    if odd.sum() > TOLERATED * np.isfinite(values).sum():
        first = float(values[odd.argmax()])
        table.refuse(key, odd, f"is not a plausible {WHAT[key]} in degC{_question(first, high)}")
    row = int(odd.argmax())
    note = (
        f"{table.place(row, key)}: {values[row]:g} degC can't be; "
        f"{odd.sum()} such cell{'s' if odd.sum() > 1 else ''} counted as missing"
    )
    return np.where(odd, np.nan, values), [note]


def _question(value: float, high: float) -> str:
    if KELVIN[0] <= value <= KELVIN[1]:
        return "; is it kelvin?"
    if high < value < KELVIN[0]:
        return "; is it Fahrenheit? A box that is so hot says so in its twin file: sensor: {highest_c: ...}"
    return ""


Mask = NDArray[np.bool_]
SPIKE_SDS, SPIKE_K = 6.0, 1.5  # a reading this far from both neighbours, which agree, is no temperature
FIRST_AGREE = 0.1  # of how far a first reading is off, that the next two may be apart
MOSTLY_DIFFERENT, BY_CHANCE = 0.5, 1e-4  # shares of readings: that repeat the last; that are called stuck
STUCK_CHANGES = 2.0  # usual ones, from a stuck reading to the next
LEAST_ROWS = 30  # beside a stretch, that tell how readings usually are
AFTER_CHANGE = 0.2  # share of a change in one direction alone
DUTY_JUMP_K, FAN_JUMP_K = 20.0, 10.0  # more than the air changes in a row by all the heat, or by the fan


def spikes(runs: RunBatch) -> Mask:
    """Single readings farther from both neighbours than any input can make them, [B, N + 1]."""
    found = np.zeros(runs.temp.shape, dtype=bool)
    for _ in range(runs.temp.shape[1]):  # the worst first: beside one, a good reading stands out as well
        more = _worst(np.where(found, np.nan, runs.temp), runs)
        if not more.any():
            break
        found |= more
    return found


def _worst(readings: Floats, runs: RunBatch) -> Mask:
    """Return the readings that are too far off and exceed their neighbours."""
    before = np.stack([hold(row) for row in readings])
    after = np.stack([hold(row[::-1])[::-1] for row in readings])
    low, high = np.minimum(before[:, :-2], after[:, 2:]), np.maximum(before[:, :-2], after[:, 2:])
    temp = readings[:, 1:-1]
    known = np.isfinite(temp)
    outside = np.maximum(temp - high, low - temp)  # of what lies between its neighbours
    off = np.where(known, outside, 0.0)
    usual = 1.4826 * np.median(np.abs(temp - 0.5 * (low + high))[known]) if known.any() else 0.0
    jump = np.zeros(runs.duty.shape)  # that an input's change might make, there and back
    for column, most_k in ((runs.duty, DUTY_JUMP_K), (runs.fan, FAN_JUMP_K)):
        jump += most_k * np.abs(np.diff(column, axis=1, prepend=0.0))
    into, out = jump[:, :-1], jump[:, 1:]  # only a change and one back make a peak of one row
    least = max(SPIKE_SDS * usual, SPIKE_K) + np.minimum(into, out) + AFTER_CHANGE * np.maximum(into, out)
    bent = np.zeros(readings.shape)  # a slope leaves this, so that it ranks neighbours where `off` may not
    bent[:, 1:-1] = np.where(known, np.abs(temp - 0.5 * (low + high)), 0.0)
    found = np.zeros(readings.shape, dtype=bool)
    found[:, 1:-1] = (off > least) & (bent[:, 1:-1] >= np.maximum(bent[:, :-2], bent[:, 2:]))
    return found


def wrong_first(readings: Floats) -> Mask:
    """Return the runs whose first reading stands alone: far from the next two, which agree [B].

    readings : [B, N + 1]
    """
    temp = np.stack([hold(row[::-1])[::-1] for row in readings[:, :4]])
    off = np.abs(temp[:, 1] - temp[:, 0])
    return np.asarray((off > SPIKE_K) & (np.abs(temp[:, 2] - temp[:, 1]) < FIRST_AGREE * off))


def stuck_readings(runs: RunBatch) -> Mask:
    """Return the readings that repeat for longer than chance allows,
    without the first of each stretch, [B, N + 1].

    Only where readings mostly differ from one row to the next: a coarse or steady sensor repeats itself. What
    goes on from where it stood was steady.
    """
    temp = runs.temp
    same = np.zeros(temp.shape, dtype=bool)
    same[:, 1:] = temp[:, 1:] == temp[:, :-1]
    stretches = list(_stretches(same))
    longest = max((end - first for _, first, end in stretches), default=0)
    rows = int(np.isfinite(temp).sum())
    # How often two in a row are the same by chance, the longest stretch left out of the count.
    usual = (int(same.sum()) - longest + 1.0) / max(rows - longest, 2)
    found = np.zeros(temp.shape, dtype=bool)
    if usual > MOSTLY_DIFFERENT or rows - longest < LEAST_ROWS:
        return found
    change = np.abs(np.diff(temp, axis=1))
    far_k = STUCK_CHANGES * float(np.median(change[change > 0.0]))
    for i, first, end in stretches:
        goes_on = end < temp.shape[1] and np.abs(temp[i, end] - temp[i, end - 1]) <= far_k
        if not goes_on and np.log(rows) + (end - first) * np.log(usual) < np.log(BY_CHANCE):
            found[i, first:end] = True
    return found


def _stretches(same: Mask) -> Iterator[tuple[int, int, int]]:
    """Run, first row and end of each stretch of rows that are."""
    for i, row in enumerate(same):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        yield from ((i, int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True))
