"""A table of figures, as text, as HTML and as Markdown: the one of reports, notebooks and benches."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Table:
    """Cells are text already; the first of each row names it.

    title : "" for a table that stands alone
    words : all columns hold words, so that none is aligned to the right
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    words: bool = False

    def text(self) -> Iterator[str]:
        """Yield lines, names to the left and figures to the right, and an empty one below."""
        widths = [max(len(row[i]) for row in (self.heads, *self.rows)) for i in range(len(self.heads))]
        if self.title:
            yield self.title
        for row in (self.heads, *self.rows):
            cells = (
                cell.ljust(width) if self.words or column == 0 else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            line = "  ".join(cells)
            yield line.rstrip() if self.words else line
        if self.note:
            yield self.note
        yield ""

    def html(self) -> Iterator[str]:
        """Yield lines of one <table> with its title, and the note below."""
        title = f"<h3>{escape(self.title)}</h3>" if self.title else ""
        yield f"{title}<table>"
        yield f"<tr>{_cells(self.heads, 'th')}</tr>"
        for row in self.rows:
            yield f"<tr>{_cells(row, 'td')}</tr>"
        yield "</table>"
        if self.note:
            yield f"<p class=note>{escape(self.note)}</p>"

    def markdown(self) -> Iterator[str]:
        """Yield lines of the title in bold, and of the rows between pipes."""
        if self.title:
            yield from (f"**{self.title}**", "")
        head, *rows = (f"| {' | '.join(row)} |" for row in (self.heads, *self.rows))
        yield from (head, "|" + "---|" * len(self.heads), *rows)


def _cells(row: Sequence[str], tag: str) -> str:
    return "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)
