"""A comparison's tables as text, and as the controllers' part of the report."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from training.control.comparison import RunResult, references_of, table
from training.control.energy import energy_tables
from training.reports.comparison_report import words_as_html
from training.reports.report_table import Table, as_html, as_text

COMMAND = "greenhouse-train compare"


def text_of(results: Sequence[RunResult], names: Sequence[str]) -> str:
    """The tables."""
    lines = [line for each in _tables(results, names) for line in as_text(each)]
    return "\n".join([COMMAND, "", *lines]) + "\n"


def section(
    results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes], findings: str
) -> str:
    """The controllers' part of the report, as HTML; findings : as `words_as_html` takes it."""
    return "\n".join(_section(results, names, pictures, findings)) + "\n"


def _section(
    results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes], findings: str
) -> Iterator[str]:
    yield "<h1>Controllers on the virtual rig, compared</h1>"
    yield f"<p>Made by <code>{COMMAND}</code>: the whole daemon with each controller, the same rooms.</p>"
    yield from words_as_html(findings)
    for each in _tables(results, names):
        yield from as_html(each)
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def _tables(results: Sequence[RunResult], names: Sequence[str]) -> list[Table]:
    references = references_of(results)
    tables = [table(results, names, reference) for reference in references]
    return tables + [one for each in references for one in energy_tables(results, names, each)]
