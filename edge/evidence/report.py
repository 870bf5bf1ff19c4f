"""The report of a record, made from the proved archive alone: one HTML page, and its lines for a terminal."""

import importlib.util
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.diagnosis.report.markup import STYLE, TableColumn, bullets, command, fold, paragraph, table
from edge.diagnosis.report.number_text import DASH, number, percent
from edge.diagnosis.report.picture import AFTER, BEFORE, PLAIN, Picture, legend_above, new_figure, style, svg
from edge.evidence.chain_files import DAY_S, begin_of
from edge.evidence.figures import (
    MeasuredFigure,
    VerdictOfRecord,
    days_without_data,
    figures,
    full_days,
    provoked_cases,
)
from edge.evidence.proof import ProvenRecord
from edge.evidence.protocol import DAYS, FAULTS, REPEATS, protocol_sha256
from edge.evidence.record_table import Floats, RecordTable
from edge.formats.table import Table

WORDS = {True: "met", False: "MISSED", None: "open"}
HEADLINES = {
    VerdictOfRecord.SUCCESS: "Success: every threshold is met",
    VerdictOfRecord.FAILURE: "Failure: a threshold is missed",
    VerdictOfRecord.UNFINISHED: "Not finished: days or measurements are missing",
}
COLOURS = {
    VerdictOfRecord.SUCCESS: "nothing_missing",
    VerdictOfRecord.FAILURE: "before",
    VerdictOfRecord.UNFINISHED: "unknown",
}
LIMITS_OF_PROOF = (
    "The seal proves that nothing was changed, left out or put in after each day was signed.",
    "The seal does not prove that the readings come from a greenhouse: the owner of rig and key can invent.",
    "The times are the rig's own clock. A head published on a day proves that the record is no younger.",
    "A person with the key can seal another record from the start, unless an early head was published.",
)


def check_protocol(record: ProvenRecord) -> None:
    """Refuse a record that began under other thresholds than this software's. Errors: DataError"""
    if record.start.protocol_sha256 != protocol_sha256():
        raise DataError(
            f"start.json: the record began with other thresholds: use software {record.start.software}"
        )


def report(record: ProvenRecord, columns: RecordTable) -> tuple[str, list[str]]:
    """Return the page, and lines for a terminal. Errors: DataError"""
    check_protocol(record)
    found, verdict = figures(record, columns)
    page = "\n".join(_page(record, columns, found, verdict)) + "\n"
    return page, list(_lines(record, found, verdict))


def proof_lines(record: ProvenRecord) -> Iterator[str]:
    """Yield what the proof of a record says, for a terminal."""
    start, days = record.start, record.days
    until = f"{days[0].date} to {days[-1].date}" if days else "no day yet"
    yield f"order         {len(days)} days, {until}; each entry names the one before"
    ticks = sum(day.ticks for day in days)
    yield f"completeness  {ticks} ticks; {record.missing} numbers without a tick"
    for day in days:
        for gap in day.gaps:
            yield f"    {day.date}  {gap.first_seq} to {gap.last_seq}: {_gap_reason(gap.reason)}"
    histories = (start.history_id, *(day.history_id for day in days))
    for day, (before, after) in zip(days, pairwise(histories), strict=True):
        if after != before:
            yield f"    {day.date}  the history is another one from here on"
    yield "changed       nothing since each day was signed"
    yield "signed by     the Ed25519 key with the SHA-256"
    yield f"              {record.signer}"
    times = f"{_time(start.started_utc)} to {_time(record.seal.sealed_utc)}"
    yield f"when          {times} by the rig's clock"
    yield f"head          {record.heads[-1]}"


def _lines(record: ProvenRecord, found: list[MeasuredFigure], verdict: VerdictOfRecord) -> Iterator[str]:
    rows = tuple((one.threshold.key, _value(one), one.threshold.rule, _word(one)) for one in found)
    yield from Table("", ("criterion", "measured", "success", ""), rows, words=True).text()
    yield f"{HEADLINES[verdict]} ({len(full_days(record))} of {DAYS} days)"


def _page(
    record: ProvenRecord, columns: RecordTable, found: list[MeasuredFigure], verdict: VerdictOfRecord
) -> Iterator[str]:
    title = escape(HEADLINES[verdict])
    yield f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<style>{STYLE}</style></head><body><main>"
    yield f'<div class="verdict {COLOURS[verdict]}">{verdict.value}</div><h1>{title}</h1>'
    yield paragraph(
        f"{len(full_days(record))} of {DAYS} days of the protocol, and the rest of the day of the start, "
        f"{record.start.date}. The thresholds were fixed before the start and are bound by it."
    )
    if (picture := air_picture(record, columns)) is not None:
        drawn = picture.svg.replace("<svg", f'<svg role="img" aria-label="{escape(picture.title)}"', 1)
        yield f"<figure>{drawn}<figcaption>{escape(picture.caption)}</figcaption></figure>"
    for head, lines in (
        ("Thresholds", _thresholds(found)),
        ("Days without data", _missing_days(record, columns)),
        ("Provoked faults", _faults(columns)),
        ("Missing ticks", _gaps(record)),
        ("The rig", _rig(record, columns)),
        ("Proof", _proof(record)),
    ):
        yield f"<h2>{head}</h2>"
        yield from lines
    yield "</main></body></html>"


def _thresholds(found: list[MeasuredFigure]) -> Iterator[str]:
    names = (TableColumn("measured over the record", words=True), TableColumn("value"))
    rows = [(one.threshold.text, _value(one), one.threshold.rule, _word(one)) for one in found]
    missed = [one.passes is False for one in found]
    yield from table((*names, TableColumn("success"), TableColumn("", words=True)), rows, missed)


def _missing_days(record: ProvenRecord, columns: RecordTable) -> Iterator[str]:
    missing = days_without_data(record, columns)
    if not missing:
        yield paragraph(f"None of the {len(full_days(record))} whole days that are sealed.")
        return
    rows = [(day.date, str(day.ticks), percent(share)) for day, share in missing]
    yield from table((TableColumn("day", words=True), TableColumn("ticks"), TableColumn("of the day")), rows)


def _faults(columns: RecordTable) -> Iterator[str]:
    cases = provoked_cases(columns)
    rows = [(case.fault.name, _time(case.begin_utc), _minutes(case.after_min)) for case in cases]
    if rows:
        yield from table(
            (TableColumn("fault", words=True), TableColumn("provoked"), TableColumn("named after [min]")),
            rows,
        )
    counts = {fault.name: sum(case.fault is fault for case in cases) for fault in FAULTS}
    if few := [f"{name}: {count} of {REPEATS}" for name, count in counts.items() if count < REPEATS]:
        yield paragraph("Not provoked often enough:")
        yield bullets(few)
    if columns.late_marks:
        marks = ", ".join(f"{mark.what} {mark.edge}" for mark in columns.late_marks)
        yield paragraph(f"Marks sealed on a later day than their own do not count: {marks}.")


def _gaps(record: ProvenRecord) -> Iterator[str]:
    rows = [
        (day.date, f"{gap.first_seq} to {gap.last_seq}", _gap_reason(gap.reason))
        for day in record.days
        for gap in day.gaps
    ]
    if not rows:
        yield paragraph("None: every number from the first tick to the last has its tick.")
        return
    heads = (TableColumn("day", words=True), TableColumn("numbers"), TableColumn("reason", words=True))
    yield from table(heads, rows)


def _rig(record: ProvenRecord, columns: RecordTable) -> Iterator[str]:
    """Yield each value of the rig's facts with the days from which it held; settings are folded."""
    rows = []
    before: dict[str, Any] = {}
    for day, facts in zip(record.days, columns.facts, strict=False):
        for name, value in facts.items():
            if name != "files" and before.get(name) != value:
                rows.append((name, plain(str(value)), day.date))
        before = facts
    heads = (TableColumn("", words=True), TableColumn("", words=True), TableColumn("from", words=True))
    yield from table(heads, rows)
    for name, text in dict(before.get("files") or {}).items():
        yield from fold(f"{plain(str(name))} of the last day", [command(str(text))])


def _proof(record: ProvenRecord) -> Iterator[str]:
    yield command("\n".join(proof_lines(record)))
    yield bullets(LIMITS_OF_PROOF)


def _value(one: MeasuredFigure) -> str:
    if one.value is None:
        return DASH
    if math.isinf(one.value):
        return "not named"
    text = f"{one.value:.0f}" if one.value.is_integer() else number(one.value)
    return f"{text} {one.threshold.unit}".strip()


def _word(one: MeasuredFigure) -> str:
    return f"{WORDS[one.passes]}, {one.note}" if one.note else WORDS[one.passes]


def _minutes(value: float) -> str:
    return "not named" if math.isinf(value) else number(value)


def _gap_reason(reason: str) -> str:
    return plain(reason) or "NO REASON in the history"


def _time(utc: float) -> str:
    try:
        return datetime.fromtimestamp(utc, UTC).strftime("%Y-%m-%d %H:%M UTC")
    except (ValueError, OverflowError, OSError):
        return f"{utc:g} s after 1970"


HEIGHT_IN = 2.8
HOUR_S = 3600.0


def air_picture(record: ProvenRecord, table: RecordTable) -> Picture | None:
    """Return the picture, None without matplotlib or without a good reading."""
    if importlib.util.find_spec("matplotlib") is None or np.isnan(table.air_c).all():
        return None
    zero_utc = begin_of(record.days[0].date)
    hours, low, high, reference = _hourly(table, zero_utc, len(record.days))
    with style():
        figure = new_figure(HEIGHT_IN)
        axes = figure.subplots()
        axes.fill_between(hours / 24.0, low, high, color=AFTER, alpha=0.6, linewidth=0, label="air")
        axes.plot(hours / 24.0, reference, color=BEFORE, linewidth=0.9, label="reference")
        for day, _ in days_without_data(record, table):
            first = (begin_of(day.date) - zero_utc) / DAY_S
            axes.axvspan(first, first + 1.0, color=PLAIN, alpha=0.25, linewidth=0)
        for span in table.marked:
            axes.axvline((span.begin_utc - zero_utc) / DAY_S, color=PLAIN, linewidth=0.7, linestyle=":")
        axes.set_title("Air and reference")
        axes.set_xlabel(f"days since {record.days[0].date}")
        axes.set_ylabel("°C")
        axes.set_xlim(0.0, float(len(record.days)))
        legend_above(axes, 2)
        return Picture(
            svg(figure),
            "Air and reference over the record",
            "Lowest to highest good reading of each hour, and the reference. Grey: days without data. "
            "Dotted: a mark begins.",
        )


def _hourly(table: RecordTable, zero_utc: float, days: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return hours since `zero_utc`, lowest and highest air, and mean reference, NaN where unknown."""
    hour = np.floor((table.utc - zero_utc) / HOUR_S)
    is_known = ~np.isnan(table.air_c)
    hours = np.arange(24 * days, dtype=np.float64)  # ticks of a wrong clock lie outside
    found = np.full((3, len(hours)), np.nan)
    for place, one in enumerate(hours):
        rows = is_known & (hour == one)
        if rows.any():
            reference = table.reference_c[rows]
            known = reference[~np.isnan(reference)]
            mean = float(known.mean()) if len(known) else np.nan
            found[:, place] = table.air_c[rows].min(), table.air_c[rows].max(), mean
    return hours + 0.5, found[0], found[1], found[2]
