"""Text for the terminal about a log's guesses."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from edge.core.plain_text import plain
from edge.data_intake.look import UNKNOWN, LogLook

NAME, EXAMPLE = 24, 20  # characters of a cell of the table


def look_text(found: LogLook, paths: Sequence[Path], place: Path) -> str:
    """Return a table of the columns and guesses, and the next steps."""
    return "\n".join(_lines(found, paths, place)) + "\n"


def _lines(found: LogLook, paths: Sequence[Path], place: Path) -> Iterator[str]:
    layout = found.mapping.layout
    files = "1 file" if len(paths) == 1 else f"{len(paths)} files"
    cut = _layout(layout.delimiter, layout.decimal)
    yield f"{files}, {found.rows} rows, usually {found.step_s:g} s apart; {cut}"
    yield _row("column", "first value", "lowest", "highest", "missing", "taken for")
    for column in found.columns:
        low, high = ("" if value is None else f"{value:.5g}" for value in (column.low, column.high))
        yield _row(column.name, column.example, low, high, str(column.missing), column.meaning or "-")
    if found.mapping.guesses:
        yield "Guesses, to be read:"
    for where, why in found.mapping.guesses.items():
        yield f"  {where}: {why}"
    yield f"Mapping: {place}"
    if any(source.column == UNKNOWN for source in found.mapping.columns.values()):
        yield f"Put the names in the place of {UNKNOWN!r}, then:"
    names = " ".join(plain(str(path), 200) for path in paths[:3]) + (" ..." if len(paths) > 3 else "")
    yield f"  greenhouse data convert {names} --map {place} --out runs/"


def _row(name: str, example: str, low: str, high: str, missing: str, meaning: str) -> str:
    ours = f"{_cut(name, NAME):<{NAME}}{_cut(example, EXAMPLE):<{EXAMPLE}}"
    return f"{ours}{low:>10}{high:>10}{missing:>9}  {meaning}"


def _layout(delimiter: str, decimal: str) -> str:
    if not delimiter:
        return "a spreadsheet"
    names = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "bars"}
    return (
        f"{names.get(delimiter, delimiter)} between cells, decimal {'comma' if decimal == ',' else 'point'}"
    )


def _cut(text: str, length: int) -> str:
    clean = plain(text, 200)
    return clean if len(clean) < length else clean[: length - 2] + "… "
