"""The page: one HTML file that needs nothing beside it."""

import shlex
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.report.cause_sections import remainder_section, rivals, search_section, what
from edge.diagnosis.report.gap_sections import gap_table, run_table, tiles
from edge.diagnosis.report.markup import TableColumn, bullets, command, fold, paragraph, table, terms
from edge.diagnosis.report.number_text import duration, nats, number, odds
from edge.diagnosis.report.page_style import STYLE
from edge.diagnosis.report.picture import Picture
from edge.diagnosis.report.where_sections import where_tables
from edge.diagnosis.report.wording import (
    cautions,
    gap_sentence,
    gloss,
    headline,
    is_changed,
    join_names,
    meaning,
    new_twin,
    predicting,
)

NO_PICTURES = (
    "No pictures: they need matplotlib. Install it with `pip install matplotlib` and diagnose again."
)
WORDS = {
    "free run": "the twin simulated over a whole run from its first rows, without another look at the air",
    "RMSE, MAE": "root of the mean square, and mean size, of measured minus free run",
    "noise floor": "the RMSE that is left to a twin with the right effects and values: sensor noise, steps of"
    " the reading, and heat that no input explains",
    "residual heat": "heat into the air that, added to the twin, would make it show what was measured",
    "log odds": "how much better the runs are explained [nat]: 3 are odds of 20 to 1, if the noise is as it"
    " was found",
    "innovation": "measured minus what was predicted from the row before",
    "white": "without a pattern in time, like noise",
}
_VERDICTS = {"named": "Named", "nothing_missing": "Nothing missing", "unknown": "Unknown"}


def page(document: DiagnosisDocument, pictures: Mapping[str, tuple[Picture, ...]] | None, folder: str) -> str:
    """Return the report.

    pictures : by section (run, gap, where, sure, left); None where they can't be drawn
    folder : of the report, for the command that adopts the new twin
    """
    return "\n".join(_lines(document, pictures, folder)) + "\n"


def _lines(
    document: DiagnosisDocument, pictures: Mapping[str, tuple[Picture, ...]] | None, folder: str
) -> Iterator[str]:
    shown = pictures or {}
    title = escape(headline(document))
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{STYLE}</style></head><body><main>"
    verdict = document["verdict"]
    yield f'<div class="verdict {verdict}">{_VERDICTS[verdict]}</div><h1>{title}</h1>'
    glosses = [gloss(effect) for effect in document["effects"]]
    yield from (paragraph(sentence) for sentence in (*glosses, *meaning(document), gap_sentence(document)))
    yield from (paragraph(sentence) for sentence in (*cautions(document), *predicting(document)))
    yield from tiles(document)
    if pictures is None:
        yield paragraph(NO_PICTURES, "soft")
    for head, lines, name in _sections(document, folder):
        yield f"<h2>{head}</h2>"
        yield from lines
        yield from _figures(shown, name)
    yield "</main></body></html>"


def _sections(document: DiagnosisDocument, folder: str) -> Iterator[tuple[str, Iterator[str], str]]:
    """Head, lines, and the name of the pictures behind them."""
    yield "Where the twin disagrees", where_tables(document), "where"
    yield "What is missing, and how sure that is", what(document), ""
    if document["effects"]:
        yield "Rivals", rivals(document), ""
    yield ("Before and after" if is_changed(document) else "The twin as it is"), gap_table(document), "run"
    yield "What to do next", _next(document, folder), ""
    yield "Details: run by run", run_table(document), ""
    yield "Details: what was tried", search_section(document), "tried"
    yield "Details: what is left", remainder_section(document), "left"
    yield "Details: words, and where this comes from", _origin(document), ""


def _figures(pictures: Mapping[str, tuple[Picture, ...]], section: str) -> Iterator[str]:
    for picture in pictures.get(section, ()):
        drawn = picture.svg.replace("<svg", f'<svg role="img" aria-label="{escape(picture.title)}"', 1)
        yield f"<figure>{drawn}<figcaption>{escape(picture.caption)}</figcaption></figure>"


def _next(document: DiagnosisDocument, folder: str) -> Iterator[str]:
    experiment = document["next_experiment"]
    if experiment:
        yield "<h3>The next experiment</h3>"
        yield from _experiment(experiment, folder)
    if is_changed(document) and (against := document.get("against_adopting")):
        yield "<h3>Not to be adopted</h3>"
        yield bullets(against)
    if twin := new_twin(document):
        yield "<h3>Adopt the new twin</h3>"
        yield paragraph(
            f"It is {twin} beside this report. On a rig it runs in shadow beside the one before; the second"
            " command takes it back."
        )
        yield command(f"greenhouse twin adopt {shlex.quote(folder)}\ngreenhouse twin adopt --back")
    elif not experiment:
        yield paragraph("Nothing: there is no twin to adopt and no experiment to run.")


def _experiment(experiment: Mapping[str, Any], folder: str) -> Iterator[str]:
    """Yield the known facts of the experiment, then its further keys."""
    if "why" in experiment:
        yield paragraph(experiment["why"])
    facts = []
    if separates := experiment.get("separates"):
        facts.append(("separates", join_names([str(name) for name in separates])))
    if (seconds := experiment.get("duration_s")) is not None:
        facts.append(("takes", duration(seconds)))
    if (log_odds := experiment.get("expected_log_odds")) is not None:
        facts.append(("expected log odds", f"{nats(log_odds)} nat: {odds(log_odds)}"))
    worded = ("why", "separates", "duration_s", "expected_log_odds", "profile")
    facts += [(key, _plain(value)) for key, value in experiment.items() if key not in worded]
    if facts:
        yield from table((TableColumn("", words=True), TableColumn("", words=True)), facts)
    if "profile" in experiment:
        profile = shlex.quote(str(Path(folder) / experiment["profile"]))
        yield command(f"greenhouse experiment {profile} --out next_run.csv")


def _origin(document: DiagnosisDocument) -> Iterator[str]:
    facts = {
        "command": document.get("command"),
        "twin before": document.get("twin_before"),
        "twin after": document.get("twin_after"),
        "data (SHA-256)": document.get("data_sha256"),
        "software": document.get("software"),
        "took": duration(document["seconds"]),
    }
    told = [(key, value) for key, value in facts.items() if value]
    yield from fold("Words used here", [terms(WORDS.items())])
    yield '<div class="hash">'
    yield from table((TableColumn("", words=True), TableColumn("", words=True)), told)
    yield "</div>"
    runs = [*document["gap"]["before"]["train"]["per_run"], *document["predictions"]]
    if runs:
        yield from fold(f"{len(runs)} runs", [paragraph(", ".join(dict.fromkeys(runs)))])


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    return ", ".join(map(_plain, value)) if isinstance(value, (list, tuple)) else str(value)
