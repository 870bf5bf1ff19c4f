"""The report of a diagnosis: report.html, one file that needs nothing beside it, and diagnosis.json."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal

from edge.diagnosis.diagnosis_document import DiagnosisDocument, GapErrors, RegimeEntry, Role, RunErrors, When
from edge.diagnosis.diagnosis_file import FILE_NAME, write_json
from edge.diagnosis.report.cause_sections import remainder_section, rivals, search_section, what
from edge.diagnosis.report.markup import (
    STYLE,
    Bar,
    TableColumn,
    bullets,
    command,
    fold,
    paragraph,
    table,
    terms,
    tile,
)
from edge.diagnosis.report.number_text import DASH, duration, kelvin, nats, number, odds, percent, plus_minus
from edge.diagnosis.report.picture import Picture
from edge.diagnosis.report.pictures import pictures
from edge.diagnosis.report.story import Story
from edge.diagnosis.report.wording import (
    ROLES,
    cautions,
    gap_sentence,
    gloss,
    headline,
    is_changed,
    join_names,
    meaning,
    new_twin,
    predicting,
    rmse_k,
    scored_role,
    shrink,
    where_findings,
)
from edge.formats.atomic_file import make_folder, write_atomically

REGIMES = 10
OPEN_FINDINGS = 3  # more are folded


def where_tables(document: DiagnosisDocument) -> Iterator[str]:
    """Yield findings, regimes and events."""
    # The first few stand open: a long list would hide them.
    if found := where_findings(document):
        yield bullets(found[:OPEN_FINDINGS])
    if more := found[OPEN_FINDINGS:]:
        yield from fold(f"{len(more)} more", [bullets(more)])
    if document["regimes"]:
        yield from _regimes(document["regimes"][:REGIMES])
    else:
        yield paragraph("No regime has clearly more of the error than its share of the rows.", "soft")
    if events := document.get("events"):
        columns = (
            TableColumn("event", words=True),
            TableColumn("run", words=True),
            *map(TableColumn, ("from", "for", "heat [W]")),
        )
        rows = [
            (
                event["kind"],
                event["run"],
                duration(event["from_s"]),
                duration(event["to_s"] - event["from_s"]),
                number(event["heat_w"]),
            )
            for event in events
        ]
        yield from table(columns, rows)


def _regimes(regimes: list[RegimeEntry]) -> Iterator[str]:
    columns = [
        TableColumn("where", words=True),
        TableColumn("share of squared error", words=True),
        TableColumn("heat [W]"),
    ]
    further = {
        "heat_after_w": "heat after [W]",
        "rmse_k": "RMSE before [K]",
        "rmse_after_k": "RMSE after [K]",
    }
    # A column that no row has a value for says nothing and costs a phone's width.
    known = [key for key in further if any(regime.get(key) is not None for regime in regimes)]
    rows: list[tuple[str | Bar, ...]] = [
        (
            regime["where"],
            Bar(regime["share_of_squared_error"], percent(regime["share_of_squared_error"])),
            plus_minus(regime["heat_w"], regime["heat_w_se"]),
            *(_further(regime, key) for key in known),
        )
        for regime in regimes
    ]
    yield from table([*columns, *(TableColumn(further[key]) for key in known)], rows)
    yield paragraph(
        "Heat: what the box gains beyond the twin, with its standard error; below 0 the twin gains too much.",
        "soft",
    )


def _further(regime: Mapping[str, Any], key: str) -> str:
    if key == "heat_after_w":
        error = regime.get("heat_after_w_se")
        return plus_minus(regime.get(key), error) if error else number(regime.get(key), 2)
    return kelvin(regime.get(key))


OPEN_RUNS = 8  # a longer table of runs is folded


def tiles(document: DiagnosisDocument) -> Iterator[str]:
    """Yield the gap at a glance."""
    role, floor = scored_role(document), document["gap"]["noise_floor"][scored_role(document)]
    where = "held out" if role == "test" else "on the training runs"
    yield '<div class="tiles">'
    for when, text in _sides(document).items():
        yield tile(
            f"{kelvin(rmse_k(document, when, role))} K", f"error{text}, {where}", when if text else "after"
        )
    if floor is not None:
        yield tile(f"{kelvin(floor)} K", "noise floor: what a perfect twin leaves")
    if is_changed(document) and (closed := shrink(document, role)) is not None:
        yield tile(percent(closed), "of the gap closed")
    yield "</div>"


def gap_table(document: DiagnosisDocument) -> Iterator[str]:
    """Errors of free runs, all together."""
    yield paragraph(
        "Free runs: the twin is given the inputs and the first temperature, and no other. Held-out test runs"
        " had no part in any fit or choice."
    )
    further = [TableColumn("noise floor [K]"), *([TableColumn("closed")] if is_changed(document) else [])]
    rows = [_role_row(document, role) for role in ROLES]
    yield from table([TableColumn("", words=True), *_errors(document), *further], rows)
    if document["gap"]["before"]["test"] is None:
        yield paragraph("No temperatures of a test run were given to compare with.", "soft")


def run_table(document: DiagnosisDocument) -> Iterator[str]:
    """Errors of free runs, run by run."""
    runs = [row for role in ROLES for row in _run_rows(document, role)]
    lines = table([TableColumn("run", words=True), TableColumn("role", words=True), *_errors(document)], runs)
    yield from lines if len(runs) <= OPEN_RUNS else fold(f"Run by run ({len(runs)} runs)", lines)


def _errors(document: DiagnosisDocument) -> list[TableColumn]:
    return [
        TableColumn(f"{error}{text} [K]") for error in ("RMSE", "MAE") for text in _sides(document).values()
    ]


def _sides(document: DiagnosisDocument) -> dict[When, str]:
    """Return the sides of the gap and their words; only `before` where nothing was added."""
    return {"before": " before", "after": " after"} if is_changed(document) else {"before": ""}


def _role_row(document: DiagnosisDocument, role: Role) -> list[str]:
    sides = [document["gap"][when][role] for when in _sides(document)]
    closed = [percent(shrink(document, role))] if is_changed(document) else []
    return [ROLES[role], *_cells(sides), kelvin(document["gap"]["noise_floor"][role]), *closed]


def _run_rows(document: DiagnosisDocument, role: Role) -> list[list[str]]:
    """Return a row per run, the largest error first."""
    gaps = [document["gap"][when][role] for when in _sides(document)]
    sides = [gap["per_run"] if gap else {} for gap in gaps]
    word = "training" if role == "train" else "held out"
    names = sorted(sides[0], key=lambda name: -(sides[0][name]["rmse_k"] or 0.0))
    return [[name, word, *_cells([side.get(name) for side in sides])] for name in names]


def _cells(sides: Sequence[RunErrors | GapErrors | None]) -> list[str]:
    """Return the RMSE of each side, then the MAE."""
    keys: tuple[Literal["rmse_k", "mae_k"], ...] = ("rmse_k", "mae_k")
    return [kelvin(side[key]) if side else DASH for key in keys for side in sides]


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


PAGE_NAME = "report.html"


def write_report(folder: Path, story: Story) -> None:
    """Write both into `folder`, made where it is not there; without matplotlib the page has no pictures.

    Errors : DataError where the diagnosis is not as its schema says; OSError
    """
    make_folder(folder)
    write_json(folder / FILE_NAME, story.document)
    text = page(story.document, pictures(story), str(folder))
    write_atomically(folder / PAGE_NAME, text.encode(errors="backslashreplace"))
