"""The report of a diagnosis: report.html, one file that needs nothing beside it, and diagnosis.json."""

import shlex
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.diagnosis_file import FILE_NAME, write_json
from edge.diagnosis.report.markup import STYLE, TableColumn, bullets, command, fold, paragraph, table
from edge.diagnosis.report.number_text import duration, kelvin
from edge.diagnosis.report.picture import Picture
from edge.diagnosis.report.pictures import pictures
from edge.diagnosis.report.story import Story
from edge.diagnosis.report.wording import (
    GAP_HEADS,
    ROLES,
    WHERE_HEAD,
    against_adopting,
    cautions,
    doors,
    doubtful,
    effect_lines,
    experiment_lines,
    gap_rows,
    gap_sentence,
    headline,
    is_changed,
    meaning,
    new_twin,
    predicting,
    run_errors,
    steps_text,
    where,
)
from edge.formats.atomic_file import make_folder, write_atomically

Figures = Mapping[str, tuple[Picture, ...]]
PAGE_NAME = "report.html"
NO_PICTURES = (
    "No pictures: they need matplotlib. Install it with `pip install matplotlib` and diagnose again."
)
WORDS = (
    "Free run: the twin is given the inputs and the first temperature of a run, and no other.",
    "RMSE: root of the mean square of measured minus free run.",
    "Noise floor: the RMSE of a twin that has everything: sensor noise and steps of the reading.",
    "Held out: a run that had no part in any fit or choice.",
)
_VERDICTS = {"named": "Named", "nothing_missing": "Nothing missing", "unknown": "Unknown"}


def page(document: DiagnosisDocument, figures: Figures | None, folder: str) -> str:
    """Return the report.

    figures : by section (run, residual, gap); None where they can't be drawn
    folder : of the report, for the commands
    """
    title, verdict = escape(headline(document)), document["verdict"]
    lines = [
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style></head><body><main>",
        f'<div class="verdict {verdict}">{_VERDICTS[verdict]}</div><h1>{title}</h1>',
        *_effects(document),
        "<h2>Where and when it shows</h2>",
        *_where(document, figures),
        f"<h2>{'What the new twin changes' if is_changed(document) else 'How far the twin is off'}</h2>",
        *_changes(document, figures or {}, folder),
        "<h2>What would tell more</h2>",
        *_more(document, folder),
        *_origin(document),
        "</main></body></html>",
    ]
    return "\n".join(lines) + "\n"


def _effects(document: DiagnosisDocument) -> Iterator[str]:
    """Yield what is missing and how sure that is."""
    yield from map(paragraph, meaning(document))
    for effect in document["effects"]:
        name, equation, evidence = effect_lines(effect)
        formula = f": <code>{escape(equation)}</code>" if equation else ""
        yield f"<h3>{escape(name[:1].upper() + name[1:])}{formula}</h3>"
        yield paragraph(f"{'; '.join(evidence)}.")
    if told := doubtful(document):
        yield bullets(told)


def _where(document: DiagnosisDocument, figures: Figures | None) -> Iterator[str]:
    yield paragraph(gap_sentence(document))
    yield from [paragraph(NO_PICTURES, "soft")] if figures is None else _figures(figures, "run")
    if found := where(document):
        yield paragraph(WHERE_HEAD)
        yield bullets(found)
    else:
        yield paragraph("No regime has clearly more of the error than its share of the rows.")
    if marks := [f"{own['name']}: {own['without']}" for own in document["effects"] if "without" in own]:
        yield paragraph("The mark of each effect in measured minus twin, as long as the twin lacks it:")
        yield bullets(marks)
    if opened := doors(document):
        yield paragraph(opened)
    yield from _figures(figures or {}, "residual")


def _changes(document: DiagnosisDocument, figures: Figures, folder: str) -> Iterator[str]:
    columns = [TableColumn("RMSE of free runs [K]", words=True)]
    columns += [TableColumn(head, words=head == GAP_HEADS[-1]) for head in GAP_HEADS]
    yield from table(columns, gap_rows(document))
    yield from _figures(figures, "gap")
    if not figures.get("gap") and (steps := steps_text(document)):
        yield paragraph(f"Step by step, {steps}.")
    yield from map(paragraph, (*cautions(document), *predicting(document)))
    runs = [
        (name, words, *map(kelvin, errors))
        for role, words in ROLES.items()
        for name, errors in run_errors(document, role).items()
    ]
    heads = (TableColumn("run", words=True), TableColumn("", words=True), *map(TableColumn, GAP_HEADS[:2]))
    yield from fold(f"Run by run, RMSE in K ({len(runs)} runs)", table(heads, runs))
    yield from map(paragraph, against_adopting(document))
    if twin := new_twin(document):
        yield paragraph(
            f"To adopt the new twin, {twin} beside this report: on a rig it runs in shadow beside the one"
            " before; the second command takes it back."
        )
        yield command(f"greenhouse twin adopt {shlex.quote(folder)}\ngreenhouse twin adopt --back")


def _more(document: DiagnosisDocument, folder: str) -> Iterator[str]:
    if experiment := document["next_experiment"]:
        told, line = experiment_lines(experiment, folder)
        yield from map(paragraph, told)
        yield from [command(line)] if line else []
    else:
        yield paragraph("No experiment is open.")
    if findings := document.get("findings"):
        yield paragraph("What these runs cannot tell, and what was left out of them:")
        yield bullets(findings)


def _figures(figures: Figures, section: str) -> Iterator[str]:
    for picture in figures.get(section, ()):
        drawn = picture.svg.replace("<svg", f'<svg role="img" aria-label="{escape(picture.title)}"', 1)
        yield f"<figure>{drawn}<figcaption>{escape(picture.caption)}</figcaption></figure>"


def _origin(document: DiagnosisDocument) -> Iterator[str]:
    facts = {
        "command": document.get("command"),
        "twin before": document.get("twin_before"),
        "twin after": document.get("twin_after"),
        "data (SHA-256)": document.get("data_sha256"),
        "software": document.get("software"),
        "took": duration(document["seconds"]),
    }
    known = [(key, value) for key, value in facts.items() if value]
    yield '<div class="hash">'
    columns = (TableColumn("", words=True), TableColumn("", words=True))
    yield from fold("Words, and where this comes from", [bullets(WORDS), *table(columns, known)])
    yield "</div>"


def write_report(folder: Path, story: Story) -> None:
    """Write both into `folder`, made where it is not there; without matplotlib the page has no pictures.

    Errors : DataError where the diagnosis is not as its schema says; OSError
    """
    make_folder(folder)
    write_json(folder / FILE_NAME, story.document)
    text = page(story.document, pictures(story), str(folder))
    write_atomically(folder / PAGE_NAME, text.encode(errors="backslashreplace"))
