"""Run files whose numbers can't be what their names say: wrong units are refused, lone slips are missing.

Shares (duty, fan, light) are checked where a run file is read, see `edge/formats/run_file.py`.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.names import SIGNALS
from edge.formats.number_table import NumberTable
from edge.formats.run_file import RecordedRun, run_of

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
