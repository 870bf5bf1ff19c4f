"""A table of figures, as text and as HTML."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Table:
    """Cells are text already; the first of each row names it."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def as_text(table: Table) -> Iterator[str]:
    """Lines, names to the left and figures to the right."""
    widths = [max(len(row[i]) for row in (table.heads, *table.rows)) for i in range(len(table.heads))]
    yield table.title
    for row in (table.heads, *table.rows):
        yield "  ".join(
            _aligned(cell, width, i) for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
    if table.note:
        yield table.note
    yield ""


def as_html(table: Table) -> Iterator[str]:
    """Lines of one <table> with its title, and the note below."""
    yield f"<h3>{escape(table.title)}</h3><table>"
    yield f"<tr>{_cells(table.heads, 'th')}</tr>"
    for row in table.rows:
        yield f"<tr>{_cells(row, 'td')}</tr>"
    yield "</table>"
    if table.note:
        yield f"<p class=note>{escape(table.note)}</p>"


def _aligned(cell: str, width: int, column: int) -> str:
    return cell.ljust(width) if column == 0 else cell.rjust(width)


def _cells(row: Sequence[str], tag: str) -> str:
    return "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)
