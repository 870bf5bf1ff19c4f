"""The comparison as one HTML file that needs nothing beside it: tables, pictures, findings."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from training.evaluate.resources import ModelCost
from training.reports.report_beyond import beyond
from training.reports.report_findings import ReportFinding, findings
from training.reports.report_table import as_html
from training.reports.report_tables import Evaluation, costs_table, tables

TITLE = "Predictive models of the greenhouse, compared"
_STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; font-size: 12.5px; margin: .5em 0 }
th, td { border-bottom: 1px solid #ccc; padding: .25em .6em; text-align: right; vertical-align: top }
th:first-child, td:first-child, .words td, .words th { text-align: left }
.note { color: #555; font-size: 13px } img { max-width: 100% }
.holds { color: #176117 } .part { color: #8a5a00 } .not { color: #a11 }
"""
_BEGIN, _END = "<!-- controllers -->", "</body></html>"
_CLASSES = {"holds": "holds", "holds in part": "part", "does not hold": "not"}


def report(
    found: Evaluation, costs: Sequence[ModelCost], pictures: Mapping[str, bytes], controllers: str = ""
) -> str:
    """The page. pictures : PNG by file name without its ending, in order; controllers : their part, HTML"""
    return "\n".join([*_lines(found, costs, pictures), *_part(controllers), _END]) + "\n"


def put_section(page: Path, controllers: str) -> None:
    """Write the controllers' part into a page that `report` made, in the place of the one before."""
    if page.exists():
        models = page.read_text(encoding="utf-8").split(_BEGIN)[0].removesuffix(f"{_END}\n")
        page.write_text("\n".join([models.rstrip("\n"), *_part(controllers), _END]) + "\n", encoding="utf-8")


def _part(controllers: str) -> list[str]:
    return [_BEGIN, controllers.rstrip("\n")] if controllers else []


def _lines(found: Evaluation, costs: Sequence[ModelCost], pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>'
    yield f"<style>{_STYLE}</style></head><body><h1>{TITLE}</h1>"
    yield "<p>Made by <code>greenhouse-train evaluate</code> from the recorded runs and the kept weights of"
    yield "every seed. Every model forecasts each test run freely from its first 10 rows: its inputs and the"
    yield "room are given, the air temperature is not. Nothing was fitted or chosen on a test run.</p>"
    yield "<h2>The paper's findings and ours</h2>"
    yield from _findings(findings(found, costs))
    yield "<h2>Beyond the paper</h2>"
    yield from (f"<p>{escape(text)}</p>" for text in beyond(found))
    yield "<h2>Figures</h2>"
    for table in (*tables(found), costs_table(costs)):
        yield from as_html(table)
    yield "<h2>Pictures</h2>"
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def _findings(found: Sequence[ReportFinding]) -> Iterator[str]:
    yield "<table class=words><tr><th>the paper</th><th>on the virtual rig</th></tr>"
    for one in found:
        verdict = f'<b class="{_CLASSES[one.verdict]}">{one.verdict}</b>'
        yield f"<tr><td>{escape(one.paper)}</td><td>{verdict}. {escape(one.here)}</td></tr>"
    yield "</table>"
