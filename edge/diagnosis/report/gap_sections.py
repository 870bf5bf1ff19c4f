"""Section of the page: the gap in numbers."""

from collections.abc import Iterator, Sequence
from typing import Literal

from edge.diagnosis.diagnosis_document import DiagnosisDocument, GapErrors, Role, RunErrors, When
from edge.diagnosis.report.markup import TableColumn, fold, paragraph, table, tile
from edge.diagnosis.report.number_text import DASH, kelvin, percent
from edge.diagnosis.report.wording import ROLES, is_changed, rmse_k, scored_role, shrink

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
