"""The cells of a CSV, TSV or XLSX file as text, with the layout that they were found in."""

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from edge.core.errors import DataError, RequestError
from edge.core.plain_text import quote
from edge.formats.input_file import TABLE, read_file

DELIMITERS = (",", ";", "\t", "|")
SAMPLE_LINES = 200
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*", re.ASCII)
MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "?")  # a cell without a value, in any case
UNPACKED_MAX = 256 << 20  # of a spreadsheet, which is a zip archive [bytes]


@dataclass(frozen=True, slots=True)
class FileLayout:
    """How a file is to be read. header_line : 1 for the first line, 0 where the file has none"""

    delimiter: str
    decimal: str
    header_line: int
    encoding: str = "utf-8"


@dataclass(frozen=True, slots=True)
class Cells:
    """names : of the columns; rows : their texts; lines : of the file, the line of each row"""

    path: Path
    layout: FileLayout
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]

    def column(self, name: str) -> list[str]:
        """Return the cells of a column, stripped. Errors: DataError"""
        if name not in self.names:
            raise DataError(
                f"{self.path}: there is no column {quote(name)}, only {quote(list(self.names), 500)}"
            )
        place = self.names.index(name)
        return [row[place].strip() for row in self.rows]

    def place(self, row: int, name: str) -> str:
        """Return a cell's place in words: `log.csv: line 12: T_in`."""
        return f"{self.path}: line {self.lines[row]}: {name}"


def is_missing(cell: str) -> bool:
    """Return whether a cell has no value."""
    return cell.strip().lower() in MISSING


def number(cell: str, decimal: str) -> float | None:
    """Return the cell's number, None if it is not a number."""
    text = cell.replace(",", ".") if decimal == "," and DECIMAL_COMMA.fullmatch(cell) else cell
    return float(text) if NUMBER.fullmatch(text) else None


def read_cells(path: Path, layout: FileLayout | None = None) -> Cells:
    """Read a file, in the layout given or in the one that it seems to have.

    Errors : DataError naming file and line; RequestError for a spreadsheet without openpyxl
    """
    try:
        content = read_file(path, TABLE)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from error
    if content.startswith(b"PK\x03\x04"):
        return _cells(path, FileLayout("", ".", 1, "xlsx"), _sheet(path, content))
    text, encoding = _text(path, content)
    if layout is None:
        delimiter = _delimiter(text)
        records = _records(path, text, delimiter)
        if not any(number(cell, ",") is not None for _, row in records for cell in row):
            raise DataError(f"{path}: no line holds a number")
        layout = FileLayout(delimiter, _decimal(records, delimiter), _header(records), encoding)
    return _cells(path, layout, _records(path, text, layout.delimiter))


def _text(path: Path, content: bytes) -> tuple[str, str]:
    """UTF-8, UTF-16 with its mark, else the one that old Windows programs write."""
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text, encoding.removesuffix("-sig")
    raise DataError(f"{path}: is no text and no XLSX spreadsheet")


def _delimiter(text: str) -> str:
    """Return the delimiter that cuts most lines into the same number of
    cells, more than one; a blank if none does.
    """
    lines = [line for line in text.splitlines()[:SAMPLE_LINES] if line.strip()]
    best, most = " ", 0
    for delimiter in DELIMITERS:
        counts = Counter(line.count(delimiter) for line in lines)
        counts.pop(0, None)
        cuts, lines_cut = counts.most_common(1)[0] if counts else (0, 0)
        # A decimal comma cuts too: a semicolon or a tab that cuts as many lines is the delimiter then.
        if lines_cut > most or (lines_cut == most and best == "," and cuts):
            best, most = delimiter, lines_cut
    return best


def _records(path: Path, text: str, delimiter: str) -> list[tuple[int, list[str]]]:
    """Line and cells of each line that has any."""
    if delimiter == " ":
        lines = enumerate(text.splitlines(), start=1)
        return [(i, line.split()) for i, line in lines if line.strip()]
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
        return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except csv.Error as error:
        raise DataError(f"{path}: {error}") from error


def _sheet(path: Path, content: bytes) -> list[tuple[int, list[str]]]:
    """Return the rows of the first sheet that is not empty."""
    try:
        import openpyxl
    except ImportError:
        raise RequestError(f"{path}: spreadsheets need openpyxl: pip install openpyxl") from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(item.file_size for item in archive.infolist()) > UNPACKED_MAX:
                raise DataError(f"{path}: a spreadsheet of more than {UNPACKED_MAX >> 20} MB")
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        for sheet in book.worksheets:
            rows = [
                (i, [_spell(value) for value in row])
                for i, row in enumerate(sheet.iter_rows(values_only=True), start=1)
            ]
            filled = [(i, row) for i, row in rows if any(row)]
            if filled:
                return filled
    except DataError:
        raise
    except Exception as error:  # a library for files from anywhere: whatever it finds is the file's fault
        raise DataError(f"{path}: can't be read as a spreadsheet: {quote(str(error))}") from error
    raise DataError(f"{path}: every sheet is empty")


def _spell(value: object) -> str:
    if value is None:
        return ""
    return value.isoformat(sep=" ") if isinstance(value, datetime) else str(value)


def _decimal(records: Sequence[tuple[int, list[str]]], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [cell for _, row in records[:SAMPLE_LINES] for cell in row]
    commas = sum(bool(DECIMAL_COMMA.fullmatch(cell)) for cell in cells)
    points = sum("." in cell and bool(NUMBER.fullmatch(cell)) for cell in cells)
    return "," if commas > points else "."


def _header(records: Sequence[tuple[int, list[str]]]) -> int:
    """Return the line of the header: the last one without numbers, as wide
    as the rows of numbers; 0 without one.
    """
    widths = Counter(len(row) for _, row in records[:SAMPLE_LINES])
    width = widths.most_common(1)[0][0] if widths else 0
    before: tuple[int, list[str]] | None = None
    for line, row in records:
        if len(row) == width and any(number(cell, ",") is not None for cell in row):
            wide = before is not None and len(before[1]) == width
            return before[0] if before is not None and wide and not before[1][0].startswith("#") else 0
        before = line, row
    return 0


def _cells(path: Path, layout: FileLayout, records: Sequence[tuple[int, list[str]]]) -> Cells:
    """Return the rows under the header that are as wide as it. Errors: DataError"""
    below = [(line, row) for line, row in records if line > layout.header_line]
    head = next((row for line, row in records if line == layout.header_line), None)
    if not below:
        raise DataError(f"{path}: there are no rows of values")
    if head is None:
        below = [(line, row) for line, row in below if not row[0].lstrip().startswith("#")]
        names = [f"column {i}" for i in range(1, len(below[0][1]) + 1)]
    else:
        names = [name.strip().lstrip("\ufeff") or f"column {i}" for i, name in enumerate(head, start=1)]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise DataError(f"{path}: line {layout.header_line}: two columns are named {quote(twice[0])}")
    for line, row in below:
        # A delimiter at the end of each line, or cells that a spreadsheet left out, are none.
        row.extend([""] * (len(names) - len(row)))
        if any(cell.strip() for cell in row[len(names) :]):
            raise DataError(f"{path}: line {line}: {len(row)} cells, the header has {len(names)}")
    rows = tuple(tuple(row[: len(names)]) for _, row in below)
    return Cells(path, layout, tuple(names), rows, tuple(line for line, _ in below))
