"""The comparison as one HTML file that needs nothing beside it: tables, pictures, findings."""

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from training.evaluate.resources import ModelCost
from training.reports.report_tables import Evaluation, costs_table, tables

TITLE = "Predictive models of the greenhouse, compared"
_STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; font-size: 12.5px; margin: .5em 0 }
th, td { border-bottom: 1px solid #ccc; padding: .25em .6em; text-align: right; vertical-align: top }
th:first-child, td:first-child { text-align: left }
.note { color: #555; font-size: 13px } img { max-width: 100% }
"""
_END = "</body></html>"
FINDINGS = "findings.md"


def report(
    found: Evaluation,
    costs: Sequence[ModelCost],
    pictures: Mapping[str, bytes],
    findings: str,
    controllers: str = "",
) -> str:
    """Return the page.

    pictures : PNG by file name without its ending, in order
    findings : as `words_as_html` takes it; controllers : their part, HTML
    """
    return "\n".join([*_lines(found, costs, pictures, findings), controllers.rstrip("\n"), _END]) + "\n"


def _lines(
    found: Evaluation, costs: Sequence[ModelCost], pictures: Mapping[str, bytes], findings: str
) -> Iterator[str]:
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>'
    yield f"<style>{_STYLE}</style></head><body><h1>{TITLE}</h1>"
    yield "<p>Made by <code>greenhouse-train evaluate</code> from the recorded runs and the kept weights of"
    yield "every seed. Every model forecasts each test run freely from its first 10 rows: its inputs and the"
    yield "room are given, the air temperature is not. Nothing was fitted or chosen on a test run.</p>"
    yield from words_as_html(findings)
    yield "<h2>Figures</h2>"
    for table in (*tables(found), costs_table(costs)):
        yield from table.html()
    yield "<h2>Pictures</h2>"
    for name, content in pictures.items():
        data = base64.b64encode(content).decode("ascii")
        yield f'<p><img alt="{escape(name)}" src="data:image/png;base64,{data}"></p>'


def read_findings(results: Path) -> str:
    """Read the sentences that a person has written on a folder's figures; "" where there are none."""
    path = results / FINDINGS
    return path.read_text(encoding="utf-8") if path.exists() else ""


def words_as_html(text: str) -> Iterator[str]:
    """Lines of a text with `# headings`, paragraphs between empty lines, **bold** and *emphasis*."""
    for block in text.strip().split("\n\n"):
        words = escape(block.strip(), quote=False)
        words = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", words)
        words = re.sub(r"\*(.+?)\*", r"<em>\1</em>", words)
        if words:
            yield f"<h2>{words[2:]}</h2>" if words.startswith("# ") else f"<p>{words}</p>"
