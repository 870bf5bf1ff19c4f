"""Figures of a record against the protocol's thresholds, and the verdict."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from edge.core.messages import Severity
from edge.evidence.chain_files import DAY_S, ChainDay, begin_of
from edge.evidence.day_rows import SealedEvent
from edge.evidence.proof import ProvenRecord
from edge.evidence.protocol import (
    DAY_SHARE,
    DAYS,
    FAULTS,
    HORIZON_MIN,
    NEAR_K,
    REFERENCE_1,
    REFERENCE_2,
    REPEATS,
    THRESHOLDS,
    ProvokedFault,
    Threshold,
)
from edge.evidence.record_table import Floats, RecordTable

FAULT_NAMES = tuple(fault.name for fault in FAULTS)
COLD_AFTER_TICKS = 2  # a lease of 10 s ends within the first, the tick that shows it is the next
NO_TRIP = ("emergency_stop", "maintenance")  # of a person's own will


class VerdictOfRecord(Enum):
    """The answer of the protocol."""

    SUCCESS = "success"  # every threshold is met
    FAILURE = "failure"  # one is not
    UNFINISHED = "unfinished"  # none is missed, and days or measurements are missing


@dataclass(frozen=True, slots=True)
class MeasuredFigure:
    """A threshold and its value. value : None where nothing was measured; passes : None while it is open"""

    threshold: Threshold
    value: float | None
    passes: bool | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class ProvokedCase:
    """A provoked fault as it went. after_min : from the mark to the event, infinity where none came [min]"""

    fault: ProvokedFault
    begin_utc: float
    after_min: float


def figures(record: ProvenRecord, table: RecordTable) -> tuple[list[MeasuredFigure], VerdictOfRecord]:
    """Return every threshold with its value, and the verdict."""
    is_over = len(full_days(record)) >= DAYS
    values = dict(_values(record, table))
    found = [_figure(threshold, values[threshold.key], is_over) for threshold in THRESHOLDS]
    if any(figure.passes is False for figure in found):
        return found, VerdictOfRecord.FAILURE
    if not is_over or any(figure.passes is None for figure in found):
        return found, VerdictOfRecord.UNFINISHED
    return found, VerdictOfRecord.SUCCESS


def full_days(record: ProvenRecord) -> tuple[ChainDay, ...]:
    """Return the days that count: the first is the rest of the day of the start, later ones come too late."""
    return record.days[1 : DAYS + 1]


def days_without_data(record: ProvenRecord, table: RecordTable) -> list[tuple[ChainDay, float]]:
    """Return the days with too few ticks and the share that they have, 0..1."""
    shares = ((day, _share(day, table)) for day in full_days(record))
    return [(day, share) for day, share in shares if share < DAY_SHARE]


def provoked_cases(table: RecordTable) -> list[ProvokedCase]:
    """Return every marked fault and how long the rig took to name it."""
    return [
        ProvokedCase(fault, span.begin_utc, _named_after_min(fault, span.begin_utc, span.end_utc, table))
        for span in table.marked
        for fault in FAULTS
        if fault.name == span.what
    ]


def _figure(threshold: Threshold, value: float | None, is_over: bool) -> MeasuredFigure:
    """Keep open what later days can still change; infinity and a missed "at most" are failures at once."""
    if value is None:
        return MeasuredFigure(threshold, None, None, "nothing measured")
    passes = threshold.passes(value)
    if is_over or (threshold.at_least and passes) or math.isinf(value):
        return MeasuredFigure(threshold, value, passes)
    return MeasuredFigure(threshold, value, None, "so far")


def _values(record: ProvenRecord, table: RecordTable) -> Iterator[tuple[str, float | None]]:
    """Yield the value of every threshold by its key, None where nothing was measured."""
    normal = ~table.within()
    automatic = normal & table.automatic & ~np.isnan(table.reference_c)
    error = np.abs(table.air_c - table.reference_c)
    yield "days", float(len(full_days(record)) - len(days_without_data(record, table)))
    yield "lost", _lost_percent(record, table)
    gaps = [gap for day in record.days for gap in day.gaps if not gap.reason]
    yield "unexplained", float(sum(gap.last_seq - gap.first_seq + 1 for gap in gaps))
    yield "bytes", _mean(np.array([day.rows_bytes / 1e6 for day in record.days]))
    yield "hottest", None if np.isnan(table.air_c).all() else float(np.nanmax(table.air_c))
    yield "blind_heat", float(np.sum((table.duty > 0.0) & np.isnan(table.air_c) & normal))
    yield "false_trips", float(sum(_is_false_trip(event, table) for event in table.events))
    yield "normal", 100.0 * float(np.mean(normal)) if len(normal) else None
    yield "controlled", 100.0 * float(np.mean(automatic[normal])) if normal.any() else None
    yield "mae_reference_1", _mean(error[table.within(REFERENCE_1)])
    yield "mae_reference_2", _mean(error[table.within(REFERENCE_2)])
    yield "mae_normal", _mean(error[automatic])
    near = error[automatic & ~np.isnan(error)]
    yield "near", 100.0 * float(np.mean(near <= NEAR_K)) if len(near) else None
    yield "forecast", _forecast_errors(table, normal)[0]
    moving, persistence = _forecast_errors(table, table.within(REFERENCE_1, REFERENCE_2))
    yield "against_persistence", moving / persistence if moving is not None and persistence else None
    yield "heat_after", float(_heat_after(table)) if _has(table, "sensor_unplugged", "usb_pulled") else None
    for fault in FAULTS:
        cases = [case.after_min for case in provoked_cases(table) if case.fault is fault]
        yield fault.name, max(cases) if len(cases) >= REPEATS or math.inf in cases else None


def _share(day: ChainDay, table: RecordTable) -> float:
    """Return the share of a day's ticks that are there, by the day's median step."""
    rows = table.day == day.number
    if not rows.any():
        return 0.0
    in_day = rows & (table.utc >= begin_of(day.date)) & (table.utc < begin_of(day.date) + DAY_S)
    return float(np.sum(in_day) * np.median(table.step_s[rows]) / DAY_S)


def _lost_percent(record: ProvenRecord, table: RecordTable) -> float | None:
    """Return ticks without a row and skipped ones, outside provoked faults, by all ticks [%].

    A gap belongs to a fault where the tick after it lies in the fault's span.
    """
    if not len(table.utc):
        return None
    outside = ~table.within(*FAULT_NAMES)
    skipped = float(np.sum(table.skipped[outside]))
    missing = sum(
        gap.last_seq - gap.first_seq + 1
        for day in record.days
        for gap in day.gaps
        if not np.isin(gap.last_seq + 1, table.seq[~outside])
    )
    return 100.0 * (skipped + missing) / (len(table.utc) + skipped + missing)


def _is_false_trip(event: SealedEvent, table: RecordTable) -> bool:
    is_trip = event.key == "board.tripped" or event.key.startswith("safety.")
    if not is_trip or event.severity is not Severity.ALARM or event.text.endswith(NO_TRIP):
        return False
    utc = math.nan if event.utc is None else event.utc
    return not any(span.begin_utc <= utc <= span.end_utc for span in table.marked if span.what in FAULT_NAMES)


def _forecast_errors(table: RecordTable, chosen: NDArray[np.bool_]) -> tuple[float | None, float | None]:
    """Return the MAE of the twin's forecast and of persistence over the same pairs of chosen ticks [K]."""
    if not len(table.utc):
        return None, None
    ahead = table.utc + 60.0 * HORIZON_MIN
    order = np.argsort(table.utc, kind="stable")
    place = np.searchsorted(table.utc[order], ahead - 0.5 * table.step_s)
    later = order[np.clip(place, 0, len(order) - 1)]
    is_pair = chosen & chosen[later] & (np.abs(table.utc[later] - ahead) <= 0.5 * table.step_s)
    is_pair &= ~np.isnan(table.forecast_c + table.air_c + table.air_c[later])
    mae = _mean(np.abs(table.forecast_c - table.air_c[later])[is_pair])
    return mae, _mean(np.abs(table.air_c - table.air_c[later])[is_pair])


def _heat_after(table: RecordTable) -> int:
    """Return the ticks with heat while sensor or USB are away, from COLD_AFTER_TICKS after their mark on."""
    count = 0
    for span in table.marked:
        if span.what in ("sensor_unplugged", "usb_pulled"):
            since = span.begin_utc + COLD_AFTER_TICKS * table.step_s
            away = (table.utc > since) & (table.utc <= span.end_utc) & np.isnan(table.air_c)
            count += int(np.sum(away & (table.duty > 0.0)))
    return count


def _has(table: RecordTable, *phases: str) -> bool:
    return any(span.what in phases for span in table.marked)


def _named_after_min(fault: ProvokedFault, begin_utc: float, end_utc: float, table: RecordTable) -> float:
    times = [
        event.utc
        for event in table.events
        if event.key in fault.keys and event.utc is not None and begin_utc <= event.utc <= end_utc
    ]
    return (min(times) - begin_utc) / 60.0 if times else math.inf


def _mean(values: Floats) -> float | None:
    known = values[~np.isnan(values)]
    return float(np.mean(known)) if len(known) else None
