"""First look at a log: guesses of its time, columns, their meaning and units, each with its reason."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.data_intake.cells import Cells, is_missing, number, read_cells
from edge.data_intake.mapping import LogMap, Source
from edge.data_intake.times import SINCE_1970, formats_of, read_times
from edge.data_intake.units import BY_TARGET, TARGETS, UNITS, guess_unit, truth
from edge.formats.run_lines import OPTION_WITHOUT
from edge.twin.rollout import has_shares


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Words of a name that speak for a target, and against it; a name is split at anything but letters and digits.
FOR: Mapping[str, frozenset[str]] = {
    "temp_air_c": _words("temp temperature temperatur t t1 tin inside indoor air luft box chamber"),
    "temp_ambient_c": _words("ambient room raum outside outdoor tamb tout ext external text"),
    "heater_duty": _words("heater heat heating heizung duty q1 power pwm output hea"),
    "fan_on": _words("fan vent ventilation blower"),
    "rel_humidity_pct": _words("rh humidity hum feuchte"),
    "co2_ppm": _words("co2"),
    "light": _words("light led lamp"),
    "soil_moisture": _words("soil"),
    "tank_level": _words("tank"),
    "door_open": _words("door lid window"),
    "solar_w_m2": _words("solar sun irradiance radiation ghi globalstrahlung"),
}
ELSEWHERE = _words("ambient room raum outside outdoor tamb tout ext set setpoint reference target soil")
AGAINST: Mapping[str, frozenset[str]] = {
    "temp_air_c": ELSEWHERE | _words("heater plate t2"),
    "heater_duty": _words("temp temperature fan set setpoint"),
    "fan_on": _words("rpm temp"),
    "rel_humidity_pct": ELSEWHERE,
}
_NONE = frozenset[str]()
DEGREES = ("c", "degc", "celsius", "f", "degf", "k")  # a name that ends so is a temperature
TIME_WORDS = (
    "time",
    "timestamp",
    "date",
    "datetime",
    "zeit",
    "datum",
    "epoch",
    "seconds",
    "sec",
    "ts",
    "unix",
)


def words_of(name: str) -> list[str]:
    """`T_in [°C]` is t, in, c."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return [word for word in re.split(r"[^a-z0-9%]+", apart.lower()) if word]


def is_time(name: str) -> bool:
    """Return whether a name sounds like a time."""
    return any(word in TIME_WORDS for word in words_of(name))


def propose(names: Sequence[str]) -> dict[str, list[str]]:
    """For each target the columns that may be it, the likeliest first; none is the first of two."""
    scores = {target: {name: _score(name, target) for name in names} for target in TARGETS}
    found: dict[str, list[str]] = {}
    taken: set[str] = set()
    for target in sorted(TARGETS, key=lambda target: -max(scores[target].values(), default=0.0)):
        ranked = sorted(
            (name for name in names if scores[target][name] > 0.0), key=lambda name: -scores[target][name]
        )
        free = [name for name in ranked if name not in taken]
        if free:
            taken.add(free[0])
            found[target] = [free[0], *(name for name in ranked if name != free[0])]
    return {target: found[target] for target in TARGETS if target in found}


def _score(name: str, target: str) -> float:
    """How many words speak for it; none where one is against it."""
    if name == target:
        return 10.0
    words = words_of(name)
    if any(word in AGAINST.get(target, _NONE) for word in words):
        return 0.0
    row = FOR.get(target, _NONE)
    unit = 0.5 if target == "temp_air_c" and words and words[-1] in DEGREES else 0.0
    return unit + float(sum(word in row for word in words))


Floats = NDArray[np.float64]
UNKNOWN = "?"  # for a column that a person must name
NEEDED = ("temp_air_c", "heater_duty")
BETWEEN = (
    "a value between off and on is the share of its row for which a relay is on, from the row's beginning: "
    "where it is a speed, say `fan_control: speed` in the twin file"
)
GAP_PERIODS = 10.0  # rows farther apart begin a new run
NUMERIC = 0.9  # share of the cells of a column that are numbers or words like on


@dataclass(frozen=True, slots=True)
class LogColumn:
    """For a person: what stands in a column. meaning : ours and its unit, "" for one that is left out"""

    name: str
    example: str
    low: float | None
    high: float | None
    missing: int
    meaning: str


@dataclass(frozen=True, slots=True)
class LogLook:
    """mapping : to be written; columns, time_s, values : of the first file; rows : of all files

    step_s : usual distance of rows
    """

    mapping: LogMap
    columns: tuple[LogColumn, ...]
    rows: int
    step_s: float
    time_s: Floats
    values: dict[str, Floats]


def look(paths: Sequence[Path]) -> LogLook:
    """Errors: DataError for a file that can't be read, or one with other columns than the first."""
    cells = [read_cells(path) for path in paths]
    first = cells[0]
    for other in cells[1:]:
        if other.names != first.names:
            raise DataError(f"{other.path}: has other columns than {first.path}: look at it alone")
    guesses: dict[str, str] = {}
    values = {name: numbers_of(first, name) for name in first.names}
    time, text = _time(first, guesses)
    time_s, absolute = (
        read_times(first, time, text, "UTC") if time else (np.arange(float(len(first.rows))), False)
    )
    if absolute and text not in SINCE_1970 and not _says_zone(first, time):
        guesses["time.zone"] = "the times say no zone"
    # The median of steps that go forward: gaps and doubled rows say nothing of the logger's period.
    steps = np.diff(time_s)
    repeated = "first" if (steps == 0.0).any() else "refuse"
    if repeated == "first":
        guesses["time.repeated"] = (
            f"{int((steps == 0.0).sum())} times stand there twice; the first row of each counts"
        )
    step_s = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    columns, absent = _columns(first, values, time, guesses)
    period_s = None if time else 1.0
    mapping = LogMap(
        first.layout, time, text, "UTC", columns, GAP_PERIODS * step_s, period_s, absent, repeated, guesses
    )
    shown = tuple(_column(first, name, values[name], mapping) for name in first.names)
    return LogLook(mapping, shown, sum(len(item.rows) for item in cells), step_s, time_s, values)


def numbers_of(cells: Cells, name: str) -> Floats:
    """Return a column's numbers: 1 and 0 for words such as on and off, NaN for others."""
    found = []
    for cell in cells.column(name):
        value = number(cell, cells.layout.decimal)
        value = truth(cell) if value is None else value
        found.append(np.nan if value is None or is_missing(cell) else value)
    return np.array(found, dtype=np.float64)


def _time(cells: Cells, guesses: dict[str, str]) -> tuple[str, str]:
    """Column and format; "" where no column is one."""
    for name in sorted(cells.names, key=lambda name: not is_time(name)):
        formats = formats_of(cells.column(name), cells.layout.decimal)
        if not formats or not (is_time(name) or formats[0] not in ("seconds",)):
            continue
        if len(formats) > 1:
            guesses["time.format"] = f"could be {' or '.join(formats[1:])} as well"
        if not is_time(name):
            guesses["time.column"] = "its cells look like times"
        return name, formats[0]
    guesses["time.period_s"] = "no column is a time: say how many seconds the rows are apart"
    return "", "seconds"


def _says_zone(cells: Cells, time: str) -> bool:
    cell = next((cell for cell in cells.column(time) if not is_missing(cell)), "")
    return cell.endswith("Z") or "+" in cell[10:] or "-" in cell[10:]


def _columns(
    cells: Cells, values: dict[str, Floats], time: str, guesses: dict[str, str]
) -> tuple[dict[str, Source], tuple[str, ...]]:
    known = np.array([[not is_missing(cell) for cell in row] for row in cells.rows]).sum(axis=0)
    numeric = [
        name
        for name, count in zip(cells.names, known, strict=True)
        if name != time and count and np.isfinite(values[name]).sum() >= NUMERIC * count
    ]
    found: dict[str, Source] = {}
    for target, names in propose(numeric).items():
        name = names[0]
        unit, full, why = guess_unit(target, values[name], " ".join(words_of(name)))
        found[target] = Source(name, unit, full)
        reasons = [f"by its name; {' or '.join(names[1:])} could be it too"] if len(names) > 1 else []
        reasons += [f"by its name, {name!r}"] if name != target and not reasons else []
        if target == "fan_on" and has_shares(UNITS[unit].to_ours(values[name], full or 1.0)):
            reasons.append(BETWEEN)
        guesses[f"columns.{target}"] = "; ".join([*reasons, *filter(None, [why])])
    # A mapping with a hole is still written: its reader names the hole, and the person fills it in.
    for target in NEEDED:
        if target not in found:
            found[target] = Source(UNKNOWN, BY_TARGET[target][0])
            guesses[f"columns.{target}"] = (
                f"no column sounds like it: put its name in the place of {UNKNOWN!r}"
            )
    absent = tuple(target for target in OPTION_WITHOUT if target not in found)
    for target in absent:
        guesses[f"columns.{target}"] = "no column sounds like it; `none` says that it was not recorded"
    return found, absent


def _column(cells: Cells, name: str, values: Floats, mapping: LogMap) -> LogColumn:
    texts = cells.column(name)
    example = next((text for text in texts if not is_missing(text)), "")
    meaning = "time" if name == mapping.time else ""
    for target, source in mapping.columns.items():
        if source.column == name:
            meaning = f"{target} ({source.unit})"
    known = values[np.isfinite(values)]
    low, high = (
        (float(known.min()), float(known.max())) if len(known) and name != mapping.time else (None, None)
    )
    return LogColumn(name, example, low, high, sum(map(is_missing, texts)), meaning)
