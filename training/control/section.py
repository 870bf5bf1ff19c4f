"""A comparison in words: its tables and findings as text, and as the controllers' part of the report."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from training.control.comparison import RunResult, references_of, table
from training.control.effort import FAMILIES, lines
from training.control.energy import energy_tables
from training.control.findings import beyond, findings
from training.reports.report_findings import ReportFinding
from training.reports.report_table import Table, as_html, as_text

COMMAND = "greenhouse-train compare"


def text_of(results: Sequence[RunResult], names: Sequence[str]) -> str:
    """The tables, and the findings in words."""
    references = references_of(results)
    told = [COMMAND, ""]
    told += [line for each in _tables(results, names) for line in as_text(each)]
    for paper, found in _by_paper(results, references).items():
        told += [paper, *(f"    {reference}: {one.verdict}. {one.here}" for reference, one in found.items())]
    return "\n".join([*told, *beyond(results, references)]) + "\n"


def section(results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes]) -> str:
    """The controllers' part of the report, as HTML."""
    return "\n".join(_section(results, names, pictures)) + "\n"


def _section(
    results: Sequence[RunResult], names: Sequence[str], pictures: Mapping[str, bytes]
) -> Iterator[str]:
    references = references_of(results)
    yield "<h1>Controllers on the virtual rig, compared</h1>"
    yield f"<p>Made by <code>{COMMAND}</code>: the whole daemon with each controller, the same rooms.</p>"
    yield "<h2>The paper's findings and ours</h2><table class=words>"
    heads = "".join(f"<th>{reference.replace('_', ' ')}</th>" for reference in references)
    yield f"<tr><th>the paper</th>{heads}</tr>"
    for paper, found in _by_paper(results, references).items():
        cells = "".join(_cell(found.get(reference)) for reference in references)
        yield f"<tr><td>{escape(paper)}</td>{cells}</tr>"
    yield "</table><h2>Beyond the paper</h2>"
    yield from (f"<p>{escape(text)}</p>" for text in beyond(results, references))
    for each in (*_tables(results, names), _effort_table()):
        yield from as_html(each)
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def _by_paper(results: Sequence[RunResult], references: Sequence[str]) -> dict[str, dict[str, ReportFinding]]:
    """What the paper says -> reference -> what is so on it."""
    told: dict[str, dict[str, ReportFinding]] = {}
    for reference in references:
        for finding in findings(results, reference):
            told.setdefault(finding.paper, {})[reference] = finding
    return told


def _cell(finding: ReportFinding | None) -> str:
    return "<td></td>" if finding is None else f"<td><b>{finding.verdict}</b>. {escape(finding.here)}</td>"


def _tables(results: Sequence[RunResult], names: Sequence[str]) -> list[Table]:
    references = references_of(results)
    tables = [table(results, names, reference) for reference in references]
    return tables + [one for each in references for one in energy_tables(results, names, each)]


def _effort_table() -> Table:
    rows = tuple(
        (family.name, str(lines(family.files)), str(len(family.tuned)), str(family.knowledge), family.why)
        for family in FAMILIES
        if lines(family.files)
    )
    heads = ("family", "lines", "settings tuned", "knowledge 1-5", "why")
    return Table("What it takes", heads, rows, "Counted by python -m training.control.effort.")
