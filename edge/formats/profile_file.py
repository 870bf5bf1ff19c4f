"""Profiles: CSV tables of what shall be applied over time; a row holds until the next."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.formats.number_table import NumberTable, read_table

Floats = NDArray[np.float64]

REFERENCE_C = (-20.0, 80.0)  # sanity: the limits of today's settings are checked when it is followed [°C]
# Column -> lowest and highest value.
_RANGES = {
    "heater_duty": (0.0, 1.0),
    "fan_on": (0.0, 1.0),
    "light": (0.0, 1.0),
    "reference_c": REFERENCE_C,
}


@dataclass(frozen=True, slots=True)
class Profile:
    """Columns of equal length: `time_s` and either `heater_duty, fan_on[, light]` or `reference_c`.

    The fact `# record_from_s: 1800` in the file makes its first half hour a lead-in, e.g. to warm the box up.
    """

    columns: Mapping[str, Floats]
    path: Path
    record_from_s: float = 0.0  # what is applied before is a lead-in: it is no part of the run [s]

    @property
    def is_reference(self) -> bool:
        """True if the profile gives a reference instead of inputs."""
        return "reference_c" in self.columns

    @property
    def end_s(self) -> float:
        """Time of the last row, which marks the end of an experiment [s]."""
        return float(self.columns["time_s"][-1])

    def at(self, time_s: float) -> dict[str, float]:
        """Return the values that hold at `time_s` since the start; before 0 those of the first row."""
        row = max(0, int(np.searchsorted(self.columns["time_s"], time_s, side="right")) - 1)
        return {key: float(values[row]) for key, values in self.columns.items() if key != "time_s"}


def read_profile(path: Path) -> Profile:
    """Read a profile. Errors: DataError with file, line and column."""
    path = Path(path)
    table = read_table(path)
    names = set(table.columns) - {"time_s"}
    if not (
        names == {"reference_c"} or {"heater_duty", "fan_on"} <= names <= {"heater_duty", "fan_on", "light"}
    ):
        raise DataError(
            f"{path}: a profile has time_s and either heater_duty,fan_on[,light] or reference_c,"
            f" not {quote(sorted(names), 500)}"
        )
    for name in names:
        low, high = _RANGES[name]
        values = table.columns[name]
        table.refuse(name, ~((values >= low) & (values <= high)), f"is not in {low:g}..{high:g}")
    if "fan_on" in names:
        table.refuse("fan_on", ~np.isin(table.columns["fan_on"], (0.0, 1.0)), "is neither 0 nor 1")
    return Profile(table.columns, path, _record_from_s(table))


def _record_from_s(table: NumberTable) -> float:
    """Return the fact of this name, 0 where there is none. Errors: DataError"""
    text = table.facts.get("record_from_s", "0")
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    end_s = table.columns["time_s"][-1]
    if not (value == 0.0 or 0.0 < value < end_s):
        raise DataError(
            f"{table.path}: record_from_s: {quote(text)} is no time before the profile's end, {end_s:g} s"
        )
    return value
