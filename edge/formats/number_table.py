"""Strict CSV of numbers over time, `# key: value` lines on top: what run files and profiles are."""

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.plain_text import plain, quote
from edge.formats.atomic_file import write_atomically
from edge.formats.input_file import TABLE, read_text
from edge.formats.run_lines import cell_text, check_facts, print_head, print_rows

Floats = NDArray[np.float64]
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # no nan, no inf, no 1_000
LARGEST = 1e12  # of a cell; beyond, squares and sums overflow somewhere behind
FACT_MAX = 20_000  # characters of a line `# key: value`; notes can be long
COLUMNS_MAX = 200
NAME_MAX = 100  # characters of a column's name


@dataclass(frozen=True, slots=True)
class NumberTable:
    """Columns of equal length, at least one row, with a `time_s` that starts at 0 and rises."""

    path: Path
    columns: Mapping[str, Floats]  # NaN where the cell was empty
    facts: Mapping[str, str]
    lines: tuple[int, ...]  # line of the file that each row stands on

    def place(self, row: int, column: str) -> str:
        """Return a cell's place, to begin a message with: `run.csv: line 12: heater_duty`."""
        return f"{self.path}: line {self.lines[row]}: {column}"

    def refuse(self, column: str, bad: NDArray[np.bool_], why: str) -> None:
        """Raise DataError at the first row where `bad` is true, if any."""
        if bad.any():
            row = int(bad.argmax())
            raise DataError(
                f"{self.place(row, column)}: {cell_text(self.columns[column][row]) or 'empty'} {why}"
            )


def read_table(path: Path) -> NumberTable:
    """Read `path`. Errors: DataError with file, line and column; also for a file that can't be read."""
    try:
        table = _parse(path, io.StringIO(read_text(path, TABLE), newline=""))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    except csv.Error as error:
        raise DataError(f"{path}: {error}") from error
    time_s = table.columns["time_s"]
    table.refuse("time_s", np.isnan(time_s), "is no time")
    table.refuse("time_s", (np.arange(len(time_s)) == 0) & (time_s != 0.0), "must be 0 in the first row")
    later = np.diff(time_s, prepend=-1.0)
    table.refuse("time_s", later < 0.0, "does not come after the row before: time goes backwards")
    table.refuse("time_s", later == 0.0, "does not come after the row before: one time stands there twice")
    return table


def write_table(path: Path, columns: Mapping[str, Floats], facts: Mapping[str, str]) -> None:
    """Write a table that `read_table` reads back to the same numbers. Errors: DataError, OSError."""
    check_facts(path, facts)
    file = io.StringIO()
    print_table(file, columns, facts)
    write_atomically(path, file.getvalue())


def print_table(file: TextIO, columns: Mapping[str, Floats], facts: Mapping[str, str]) -> None:
    """Print the lines of `write_table`, for facts that are known to be right. Errors: OSError"""
    print_head(file, columns, facts)
    print_rows(file, columns.values())


def _parse(path: Path, file: TextIO) -> NumberTable:
    facts: dict[str, str] = {}
    fact_lines = 0
    for line in file:
        if not line.startswith("#"):
            break
        fact_lines += 1
        key, colon, value = line[1:].partition(":")
        if len(line) > FACT_MAX:
            raise DataError(f"{path}: line {fact_lines}: longer than {FACT_MAX} characters")
        if not colon or not key.strip():
            raise DataError(f"{path}: line {fact_lines}: {quote(line.strip())} is no `# key: value`")
        if key.strip() in facts:
            raise DataError(f"{path}: line {fact_lines}: {plain(key.strip(), 60)} stands there twice")
        facts[key.strip()] = value.strip()
    else:
        raise DataError(f"{path}: there is no header")
    names = _header(path, fact_lines + 1, next(csv.reader([line])))
    rows, lines = [], []
    reader = csv.reader(file)
    for cells in reader:
        if cells:  # a blank line is nothing
            lines.append(fact_lines + 1 + reader.line_num)
            rows.append(_row(f"{path}: line {lines[-1]}", names, cells))
    if not rows:
        raise DataError(f"{path}: there are no rows under the header")
    # Copies of the columns: a view would keep the whole table in memory for one column.
    values = np.array(rows, dtype=np.float64)
    columns = {name: values[:, i].copy() for i, name in enumerate(names)}
    return NumberTable(path, columns, facts, tuple(lines))


def _header(path: Path, line: int, cells: list[str]) -> list[str]:
    names = [cell.strip() for cell in cells]
    place = f"{path}: line {line}"
    if len(names) > COLUMNS_MAX or any(len(name) > NAME_MAX for name in names):
        raise DataError(f"{place}: more than {COLUMNS_MAX} columns, or a name of over {NAME_MAX} characters")
    if "time_s" not in names:
        raise DataError(f"{place}: time_s is not among the columns {quote(names, 500)}")
    for name in names:
        if not name or names.count(name) > 1:
            raise DataError(f"{place}: {name!r} is no name for one column")
    return names


def _row(place: str, names: list[str], cells: list[str]) -> list[float]:
    if len(cells) != len(names):
        raise DataError(f"{place}: {len(cells)} cells, the header has {len(names)}")
    return [_number(place, name, cell.strip()) for name, cell in zip(names, cells, strict=True)]


def _number(place: str, name: str, cell: str) -> float:
    if not cell:
        return float("nan")
    if not (_NUMBER.fullmatch(cell) and abs(float(cell)) <= LARGEST):
        raise DataError(f"{place}: {name}: {quote(cell)} is no number of at most {LARGEST:g}")
    return float(cell)
