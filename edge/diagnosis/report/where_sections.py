"""Section of the page: where the twin disagrees with the measurements, and when."""

from collections.abc import Iterator, Mapping
from typing import Any

from edge.diagnosis.diagnosis_document import DiagnosisDocument, RegimeEntry
from edge.diagnosis.report.markup import Bar, TableColumn, bullets, fold, paragraph, table
from edge.diagnosis.report.number_text import duration, kelvin, number, percent, plus_minus
from edge.diagnosis.report.wording import where_findings

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
