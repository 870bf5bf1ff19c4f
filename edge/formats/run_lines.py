"""The lines of run files and other tables of numbers, made without numpy: the page writes run files too."""

import csv
import io
from collections.abc import Iterable, Mapping
from typing import TextIO

from edge.core.errors import DataError

REQUIRED = ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
OPTION_WITHOUT = {"fan_on": "--no-fan", "temp_ambient_c": "--no-ambient"}  # REQUIRED that a run may lack
ABSENT = "none"  # the fact `# fan_on: none` says that the recording has no such column


def in_order(names: Iterable[str]) -> list[str]:
    """Return columns of a run as a file has them: the required ones first, then by name."""
    return sorted(names, key=lambda name: (REQUIRED.index(name) if name in REQUIRED else len(REQUIRED), name))


def absences(names: Iterable[str]) -> dict[str, str]:
    """Return a fact `NAME: none` for every column of OPTION_WITHOUT that is not among the names."""
    present = set(names)
    return {name: ABSENT for name in OPTION_WITHOUT if name not in present}


def check_facts(place: object, facts: Mapping[str, str]) -> None:
    """Refuse a fact that is not a line `# key: value`. place : of the table. Errors: DataError"""
    for key, value in facts.items():
        text = f"{key}: {value}"
        if text != text.strip() or not key or ":" in key or len(text.splitlines()) != 1:
            raise DataError(f"{place}: {text!r} is no line `# key: value`")


def print_head(file: TextIO, names: Iterable[str], facts: Mapping[str, str]) -> None:
    """Print facts and header. Errors: OSError"""
    file.writelines(f"# {key}: {value}\n" for key, value in facts.items())
    csv.writer(file, lineterminator="\n").writerow(names)


def print_rows(file: TextIO, columns: Iterable[Iterable[float]]) -> None:
    """Print the rows of columns of one length, NaN as an empty cell. Errors: OSError"""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerows([cell_text(value) for value in row] for row in zip(*columns, strict=True))


def head_text(names: Iterable[str], facts: Mapping[str, str]) -> str:
    """Return what `print_head` prints."""
    file = io.StringIO()
    print_head(file, names, facts)
    return file.getvalue()


def rows_text(columns: Iterable[Iterable[float]]) -> str:
    """Return what `print_rows` prints."""
    file = io.StringIO()
    print_rows(file, columns)
    return file.getvalue()


def cell_text(value: float) -> str:
    """Shortest text that reads back to the same number; empty for a missing one."""
    if value != value:
        return ""
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))
