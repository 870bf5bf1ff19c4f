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
h1 { font-size: clamp(1.25rem, 4.5vw, 1.6rem); line-height: 1.25; margin: .2rem 0 .6rem }
h2 { font-size: 1.2rem; margin: 1.6rem 0 .5rem; padding-top: .7rem; border-top: 1px solid var(--line) }
h3 { font-size: 1.02rem; margin: 1rem 0 .2rem }
h3 code { font-weight: normal; display: inline-block; max-width: 100%; overflow-x: auto; white-space: nowrap;
  vertical-align: bottom }
p { margin: .4rem 0 }
.verdict { font-weight: 600; font-size: .85rem; letter-spacing: .04em; text-transform: uppercase }
.named { color: var(--after) } .nothing_missing { color: var(--good) } .unknown { color: var(--open) }
figure { background: var(--card); border: 1px solid var(--line); border-radius: .5rem }
figcaption, .soft { color: var(--soft); font-size: .875rem }
figure { margin: 1rem 0; padding: .6rem }
figure svg { display: block; width: 100%; max-width: 36rem; height: auto; margin: auto; color: var(--ink) }
figcaption { margin-top: .4rem }
.table { overflow-x: auto; margin: .6rem 0 }
table { border-collapse: collapse; font-size: .9rem; min-width: 100% }
th, td { border-bottom: 1px solid var(--line); padding: .32rem .6rem; text-align: right; vertical-align: top }
th { color: var(--soft); font-weight: 600 } td.figure { white-space: nowrap }
td.words, th.words { text-align: left; min-width: 7rem } tr.kept td { font-weight: 600 }
code, pre { background: var(--code); border-radius: .25rem; font-size: .875em; padding: .1em .3em }
pre { padding: .6rem .8rem; overflow-x: auto } ul { padding-left: 1.2rem }
summary { cursor: pointer; color: var(--soft); margin: .5rem 0 }
.hash { overflow-wrap: anywhere }
@media print { body { max-width: none } figure { break-inside: avoid } }
"""


_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:K|W|%|s|min|h|d)\b|%)|(?<=±) | (?=±)")  # where no line may break


@dataclass(frozen=True, slots=True)
class TableColumn:
    """Head of a column of a table; words stand to the left and may be broken, figures to the right."""

    head: str
    words: bool = False


def paragraph(text: str, kind: str = "") -> str:
    """Return a `<p>` of class `kind`; a number and its unit stay on one line."""
    return f"<p{_class(kind)}>{_sentence(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a `<ul>` with one item per text; a number and its unit stay on one line."""
    return f"<ul>{''.join(f'<li>{_sentence(text)}</li>' for text in texts)}</ul>"


def table(
    columns: Sequence[TableColumn], rows: Iterable[Sequence[str]], kept: Sequence[bool] = ()
) -> Iterator[str]:
    """Lines of a table that scrolls by itself where the page is narrow. kept : rows that stand out"""
    yield '<div class="table"><table><tr>'
    yield "".join(f"<th{_class('words' if c.words else '')}>{escape(c.head)}</th>" for c in columns) + "</tr>"
    for number, row in enumerate(rows):
        cells = "".join(
            f"<td{_class('words' if column.words else 'figure')}>{escape(cell)}</td>"
            for column, cell in zip(columns, row, strict=True)
        )
        yield f"<tr{_class('kept' if number < len(kept) and kept[number] else '')}>{cells}</tr>"
    yield "</table></div>"


def fold(title: str, lines: Iterable[str]) -> Iterator[str]:
    """Behind a line that opens it."""
    yield f"<details><summary>{escape(title)}</summary>"
    yield from lines
    yield "</details>"


def command(text: str) -> str:
    """Return shell lines in a `<pre>`, without no-break spaces, so that a copied line runs."""
    return f"<pre>{escape(text)}</pre>"


def _sentence(text: str) -> str:
    return _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", escape(text))


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
