"""Pieces of HTML. Text that comes from outside is escaped here and nowhere else."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

BAR_REM = 4.0  # width of a bar that stands for all
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:K|W|%|s|min|h|d)\b|%)|(?<=±) | (?=±)")  # where no line may break


@dataclass(frozen=True, slots=True)
class TableColumn:
    """Head of a column of a table; words stand to the left and may be broken, figures to the right."""

    head: str
    words: bool = False


@dataclass(frozen=True, slots=True)
class Bar:
    """A cell that shows its share, 0..1, as a bar before the text."""

    share: float
    text: str


def paragraph(text: str, kind: str = "") -> str:
    return f"<p{_class(kind)}>{_sentence(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{_sentence(text)}</li>' for text in texts)}</ul>"


def tile(value: str, label: str, kind: str = "") -> str:
    return f'<div class="tile"><b{_class(kind)}>{escape(value)}</b><span>{escape(label)}</span></div>'


def table(
    columns: Sequence[TableColumn], rows: Iterable[Sequence[str | Bar]], kept: Sequence[bool] = ()
) -> Iterator[str]:
    """Lines of a table that scrolls by itself where the page is narrow. kept : rows that stand out"""
    yield '<div class="table"><table><tr>'
    yield "".join(f"<th{_class('words' if c.words else '')}>{escape(c.head)}</th>" for c in columns) + "</tr>"
    for number, row in enumerate(rows):
        cells = "".join(
            f"<td{_class('words' if column.words else 'figure')}>{_cell(cell)}</td>"
            for column, cell in zip(columns, row, strict=True)
        )
        yield f"<tr{_class('kept' if number < len(kept) and kept[number] else '')}>{cells}</tr>"
    yield "</table></div>"


def fold(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Behind a line that opens it."""
    yield f"<details><summary>{escape(title)}</summary>"
    yield from lines
    yield "</details>"


def terms(pairs: Iterable[tuple[str, str]]) -> str:
    """Words and what they mean."""
    return f"<dl>{''.join(f'<dt>{escape(word)}</dt><dd>{_sentence(text)}</dd>' for word, text in pairs)}</dl>"


def command(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"


def _sentence(text: str) -> str:
    return _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", escape(text))


def _cell(cell: str | Bar) -> str:
    if isinstance(cell, str):
        return escape(cell)
    width = BAR_REM * min(max(cell.share, 0.0), 1.0)
    return f'<span class="bar" style="width:{width:.2f}rem"></span>{_sentence(cell.text)}'


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
