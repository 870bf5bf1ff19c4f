"""Run files: recorded measurements and inputs as CSV, read strictly and brought to one period."""

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.names import SIGNALS
from edge.core.plain_text import quote
from edge.formats.number_table import NumberTable, read_table, write_table
from edge.formats.run_lines import ABSENT, OPTION_WITHOUT, REQUIRED, absences

Floats = NDArray[np.float64]
SHARES = ("heater_duty", "fan_on", *(signal.key for signal in SIGNALS.values() if signal.unit == "1"))  # 0..1
INPUTS = ("heater_duty", "fan_on", "led", "light", "reference_c")  # hold from their row to the next
KNOWN = tuple(
    dict.fromkeys(
        (
            *REQUIRED,
            *(signal.key for signal in SIGNALS.values()),
            *SHARES,
            *INPUTS,
            "ambient_rel_humidity_pct",
            "temp_air_second_c",
            "door_open",
            "solar_w_m2",
        )
    )
)
SYNONYMS = {"ambient": ("room", "outside", "out"), "temp": ("t",), "duty": ("power",), "time": ("t",)}
PERIOD_TOLERANCE = 0.01  # share of a period that a row may be off its place
PERCENT_FROM = 5.0  # a share that is so large was meant in percent
HOLE_PERIODS = 2.5  # a reading is not interpolated over a longer distance between rows


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """Columns of equal length by their names in the file, the unit in each name; NaN is a missing reading."""

    columns: Mapping[str, Floats]
    facts: Mapping[str, str] = field(default_factory=dict)  # `start_utc`, `rig`, `role`, `notes`, ...
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    @property
    def start_utc(self) -> float | None:
        """Time of the first row [s since 1970], None where the file does not say. Errors: DataError."""
        text = self.facts.get("start_utc")
        if text is None:
            return None
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise DataError(
                f"{self.path}: start_utc: {quote(text)} is no time like 2026-07-01T12:00:00Z"
            ) from None
        # A time without zone is what the fact's name says: UTC.
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def read_run(path: str | Path, without: Collection[str] = ()) -> RecordedRun:
    """Read a run file, its rows as they are (see `resample`).

    without : keys of OPTION_WITHOUT that the file may lack, in addition to those that its facts call ABSENT
    Errors : DataError, naming line and column
    """
    return run_of(read_table(Path(path)), without)


def run_of(table: NumberTable, without: Collection[str] = ()) -> RecordedRun:
    """Return the table as a run. Errors: DataError, as `read_run`"""
    _check_names(table, without)
    for name in set(SHARES) & set(table.columns):
        _check_share(table, name)
    run = RecordedRun(table.columns, table.facts, table.path)
    _ = run.start_utc  # a wrong one is refused now, not when it is needed
    return run


def absence_facts(run: RecordedRun) -> RecordedRun:
    """Return the run with a fact `NAME: none` for every column of OPTION_WITHOUT that it lacks."""
    return replace(run, facts={**run.facts, **absences(run.columns)})


def write_run(run: RecordedRun, path: str | Path) -> None:
    """Write a run file that `read_run` reads back to the same numbers. Errors: DataError, OSError."""
    write_table(Path(path), run.columns, run.facts)


def refuse_test(run: RecordedRun) -> None:
    """Before anything is fitted, tuned or chosen on a run. Errors: DataError for one of role test."""
    if run.facts.get("role", "").strip().lower() == "test":
        raise DataError(f"{run.path}: role: a test run is never fitted on")


def data_sha256(runs: Sequence[RecordedRun]) -> str:
    """Return a hash of the numbers in their order: every column's name and values, wherever the files lie."""
    digest = hashlib.sha256()
    for run in runs:
        for name in sorted(run.columns):
            values = run.columns[name]
            digest.update(f"{name} {len(values)}\n".encode())
            digest.update(np.where(np.isnan(values), np.nan, values).astype("<f8").tobytes())
    return digest.hexdigest()


def inside_names(run: RecordedRun) -> dict[str, Floats]:
    """Return the run's columns by their internal names, with `utc` where the run states its start."""
    keys = {signal.key: name for name, signal in SIGNALS.items()} | {"solar_w_m2": "solar"}
    columns = {keys.get(key, key): values for key, values in run.columns.items()}
    start_utc = run.start_utc
    return columns if start_utc is None else {**columns, "utc": start_utc + run.columns["time_s"]}


def cut(run: RecordedRun, begin: int, end: int) -> RecordedRun:
    """Rows `begin` to `end` - 1, at least one, as a run of their own that begins at time 0."""
    columns = {name: values[begin:end] for name, values in run.columns.items()}
    start_s = float(columns["time_s"][0])
    facts = dict(run.facts)
    if run.start_utc is not None:
        moment = datetime.fromtimestamp(run.start_utc + start_s, UTC)
        facts["start_utc"] = moment.isoformat(timespec="milliseconds")
    return replace(run, columns=columns | {"time_s": columns["time_s"] - start_s}, facts=facts)


def period(run: RecordedRun) -> float:
    """Return the period of the rows [s]. Errors: DataError for a single row or irregular ones"""
    time_s = run.columns["time_s"]
    if len(time_s) < 2:
        raise DataError(f"{run.path}: one row has no period")
    step_s = float(time_s[-1] / (len(time_s) - 1))
    off = np.abs(time_s - step_s * np.arange(len(time_s))) > PERIOD_TOLERANCE * step_s
    if off.any():
        raise DataError(
            f"{run.path}: rows are irregular (first at {time_s[off.argmax()]:g} s): resample the run"
        )
    return step_s


def resample(run: RecordedRun, step_s: float) -> RecordedRun:
    """Return the run at rows 0, `step_s`, 2 `step_s`, ... up to its end.

    Inputs are the mean of what held during the new step, so that no heat is gained or lost; at the old period
    or a shorter one that is what held. Readings are interpolated at the new instants: a mean over the step
    would put into a row what its own input has not done yet, or lag half a step behind. Between two readings
    that are far apart (HOLE_PERIODS of the longer period) there is none. A run that has rows just there is
    left as it is.

    Errors : DataError for a period that is none
    """
    if not step_s > 0.0:
        raise DataError(f"{run.path}: a period of {step_s} s")
    time_s = run.columns["time_s"]
    slack_s = PERIOD_TOLERANCE * step_s
    grid = step_s * np.arange(int((time_s[-1] + slack_s) / step_s) + 1, dtype=np.float64)
    # Left as it is, but on the exact grid: a clock's jitter would make the steps unequal.
    if len(grid) == len(time_s) and bool((np.abs(time_s - grid) <= slack_s).all()):
        return replace(run, columns={**run.columns, "time_s": grid})
    usual_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else step_s
    hole_s = HOLE_PERIODS * max(step_s, usual_s)
    columns = {
        name: _held_mean(time_s, values, grid, step_s)
        if _is_input(name)
        else _interpolate(time_s, values, grid, hole_s, slack_s)
        for name, values in run.columns.items()
        if name != "time_s"
    }
    return replace(run, columns={"time_s": grid, **columns})


def _check_names(table: NumberTable, without: Collection[str]) -> None:
    """Refuse a missing column that nobody declared absent, and a name that is nearly a known one."""
    for name in table.columns:
        if name not in KNOWN and (near := [known for known in _near(name) if known not in table.columns]):
            raise DataError(
                f"{table.path}: unknown column {quote(name)}: is it {' or '.join(near)}? "
                "Rename it, or give it a name unlike those"
            )
    for name in OPTION_WITHOUT:
        if table.facts.get(name, ABSENT) != ABSENT:
            raise DataError(
                f"{table.path}: {name}: {quote(table.facts[name])}: this fact can only be {ABSENT!r}"
            )
        if name in table.facts and name in table.columns:
            raise DataError(f"{table.path}: {name}: the fact says {ABSENT!r}, but the column is there")
    for name in REQUIRED:
        if name in table.columns or name in without or name in table.facts:
            continue
        known, hint = quote(list(table.columns), 500), ""
        if name in OPTION_WITHOUT:
            hint = (
                f"; where it was not recorded, say so: {OPTION_WITHOUT[name]}, "
                f"or the line '# {name}: {ABSENT}' above the header"
            )
        raise DataError(f"{table.path}: {name} is not among the columns {known}{hint}")


def _near(name: str) -> list[str]:
    """Known columns that `name` may mean: each of its words is, or begins, one of theirs, or is a slip of it.

    `fan`, `FanOn`, `temp_amb_c`, `heater_dtuy` are near a known name; `fan_rpm` and `heater_2_duty` are not.
    """
    words = _words(name)
    if not any(len(word) > 2 for word in words):
        return []
    return [known for known in KNOWN if _covers(known, words)]


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+[0-9]*|[0-9]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower())


def _covers(known: str, words: Sequence[str]) -> bool:
    if "".join(words) == known.replace("_", ""):
        return True
    left = known.split("_")
    for word in words:
        match = next((other for other in left if _alike(word, other)), None)
        if match is None:
            return False
        left.remove(match)
    return True


def _alike(word: str, other: str) -> bool:
    if word == other or word in SYNONYMS.get(other, ()):
        return True
    if not (word.isalpha() and other.isalpha()):
        return False
    if len(word) > 2 and (other.startswith(word) or (word.startswith(other) and len(other) > 2)):
        return True
    return min(len(word), len(other)) > 3 and _one_slip(word, other)


def _one_slip(a: str, b: str) -> bool:
    """One letter too many, too few, wrong, or two in the wrong order."""
    begin = 0
    while begin < min(len(a), len(b)) and a[begin] == b[begin]:
        begin += 1
    a, b = a[begin:], b[begin:]
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[:2] == b[1::-1] and a[2:] == b[2:])


def _check_share(table: NumberTable, name: str) -> None:
    values = table.columns[name]
    percent = "; is the column in percent?" if np.nanmax(values, initial=0.0) >= PERCENT_FROM else ""
    table.refuse(name, (values < 0.0) | (values > 1.0), f"is not in 0..1{percent}")
    if name in ("heater_duty", "fan_on"):
        table.refuse(name, np.isnan(values), "is unknown; an input must be known in every row")


def _is_input(name: str) -> bool:
    """Columns that nobody here knows go by their names, e.g. `heater_2_duty`."""
    return name in INPUTS or name.endswith(("_duty", "_on"))


def _held_mean(time_s: Floats, values: Floats, grid: Floats, step_s: float) -> Floats:
    """Mean over [grid, grid + step_s) of what holds from row to row, the last for good; NaN if not known."""
    edges = np.append(time_s, max(time_s[-1], grid[-1]) + step_s)
    ends = np.append(grid, grid[-1] + step_s)
    known = ~np.isnan(values)

    def means(held: Floats) -> Floats:
        area = np.concatenate(([0.0], np.cumsum(held * np.diff(edges))))
        # Rounded, so that sums of 1.0 over many rows are not 0.9999999999.
        return np.asarray(np.round(np.diff(np.interp(ends, edges, area)) / step_s, 9))

    return np.where(means(known.astype(np.float64)) == 1.0, means(np.where(known, values, 0.0)), np.nan)


def _interpolate(time_s: Floats, values: Floats, grid: Floats, hole_s: float, slack_s: float) -> Floats:
    known = ~np.isnan(values)
    if not known.any():
        return np.full(len(grid), np.nan)
    times = time_s[known]
    after = np.minimum(np.searchsorted(times, grid), len(times) - 1)
    before = np.maximum(np.searchsorted(times, grid, side="right") - 1, 0)
    near = (
        (times[after] - times[before] <= hole_s)
        & (grid >= times[0] - slack_s)
        & (grid <= times[-1] + slack_s)
    )
    return np.where(near, np.interp(grid, times, values[known]), np.nan)
