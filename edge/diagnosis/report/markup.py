"""Pieces of HTML and the style of a page. Text from outside is escaped here and nowhere else."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

STYLE = """
:root { color-scheme: light dark; --page: #fbfbf9; --card: #fff; --ink: #1c2024; --soft: #5b6570;
  --line: #dfe3e6; --before: #c2500a; --after: #0f72b8; --good: #17713f; --open: #8a5a00; --code: #f0f2f3 }
@media (prefers-color-scheme: dark) { :root { --page: #14171a; --card: #1c2125; --ink: #e6e9eb;
  --soft: #a0abb5; --line: #353d44; --before: #f08c46; --after: #58b0ea; --good: #5cc88d; --open: #e0b050;
  --code: #272d33 } }
* { box-sizing: border-box }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 50rem; background: var(--page);
  color: var(--ink); font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word }
h1 { font-size: clamp(1.45rem, 5vw, 2rem); line-height: 1.2; margin: .3rem 0 .8rem }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line) }
h3 { font-size: 1.02rem; margin: 1.4rem 0 .4rem }
p { margin: .5rem 0 }
.verdict { font-weight: 600; font-size: .85rem; letter-spacing: .04em; text-transform: uppercase }
.named { color: var(--after) } .nothing_missing { color: var(--good) } .unknown { color: var(--open) }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); gap: .6rem;
  margin: 1.2rem 0 }
.tile, figure { background: var(--card); border: 1px solid var(--line); border-radius: .5rem }
.tile { padding: .6rem .8rem }
.tile b { display: block; font-size: 1.55rem; line-height: 1.25; white-space: nowrap }
.tile span, figcaption, .soft { color: var(--soft); font-size: .875rem }
.before { color: var(--before) } .after { color: var(--after) }
figure { margin: 1rem 0; padding: .6rem }
figure svg { display: block; width: 100%; max-width: 40rem; height: auto; margin: auto; color: var(--ink) }
figcaption { margin-top: .4rem }
.table { overflow-x: auto; margin: .6rem 0 }
table { border-collapse: collapse; font-size: .9rem; min-width: 100% }
th, td { border-bottom: 1px solid var(--line); padding: .32rem .6rem; text-align: right; vertical-align: top }
th { color: var(--soft); font-weight: 600 } td.figure { white-space: nowrap }
td.words, th.words { text-align: left; min-width: 7rem } tr.kept td { font-weight: 600 }
.bar { display: inline-block; height: .65em; border-radius: 2px; background: var(--before);
  margin-right: .4em }
code, pre { background: var(--code); border-radius: .25rem; font-size: .875em; padding: .1em .3em }
pre { padding: .6rem .8rem; overflow-x: auto } ul { padding-left: 1.2rem }
dt { font-weight: 600; margin-top: .4rem } dd { margin: 0 0 0 1rem; color: var(--soft) }
summary { cursor: pointer; color: var(--soft); margin: .5rem 0 }
.hash { overflow-wrap: anywhere }
@media print { body { max-width: none } figure, .tile { break-inside: avoid } }
"""


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
    """Return a `<p>` of class `kind`; a number and its unit stay on one line."""
    return f"<p{_class(kind)}>{_sentence(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a `<ul>` with one item per text; a number and its unit stay on one line."""
    return f"<ul>{''.join(f'<li>{_sentence(text)}</li>' for text in texts)}</ul>"


def tile(value: str, label: str, kind: str = "") -> str:
    """Return a tile of the summary: a large `value` of class `kind` above its `label`."""
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
    """Return shell lines in a `<pre>`, without no-break spaces, so that a copied line runs."""
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
