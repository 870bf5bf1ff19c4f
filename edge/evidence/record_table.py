"""All ticks of a proved record as columns, with its events, marks and facts: one pass over its days."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.messages import ReadingQuality
from edge.core.names import SIGNALS
from edge.evidence.chain_files import DAY_S, ChainDay, begin_of
from edge.evidence.day_rows import SealedEvent, SealedRow, SealedTick
from edge.evidence.marks import EvidenceMark, MarkedSpan, spans
from edge.evidence.proof import ProvenRecord
from edge.evidence.protocol import FORECASTER, HORIZON_MIN

AIR = SIGNALS["temp_air"].key
NAN = math.nan
Floats = NDArray[np.float64]
COLUMNS = ("seq", "utc", "step_s", "air_c", "reference_c", "duty", "forecast_c", "skipped", "day")


@dataclass(frozen=True, slots=True)
class RecordTable:
    """Columns, one row a tick. All times in UTC [s since 1970].

    air_c : good reading, else NaN; duty : as the board confirmed, 0 where it did not; automatic : mode lets a
    controller decide; day : number of its day; late_marks : sealed on a later day than their own
    """

    seq: Floats
    utc: Floats
    step_s: Floats
    air_c: Floats
    reference_c: Floats
    duty: Floats
    forecast_c: Floats
    skipped: Floats
    day: Floats
    automatic: NDArray[np.bool_]
    events: tuple[SealedEvent, ...]
    marked: tuple[MarkedSpan, ...]
    late_marks: tuple[EvidenceMark, ...]
    facts: tuple[dict[str, Any], ...]

    def within(self, *phases: str) -> NDArray[np.bool_]:
        """Return which ticks lie in a marked span of these phases, of any where none is named."""
        found = np.zeros(len(self.utc), dtype=bool)
        for span in self.marked:
            if not phases or span.what in phases:
                found |= (self.utc >= span.begin_utc) & (self.utc <= span.end_utc)
        return found


class RecordCollector:
    """Takes the lines of a record while it is proved, and makes its table afterwards."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._events: list[SealedEvent] = []
        self._marks: list[EvidenceMark] = []
        self._late: list[EvidenceMark] = []
        self._facts: list[dict[str, Any]] = []

    def see(self, day: ChainDay, row: SealedRow) -> None:
        """Take one line."""
        if row.tick is not None:
            self._rows.append(_cells(row.tick, day.number))
            self._events += row.tick.events
        elif row.mark is not None:
            is_late = row.mark.utc < begin_of(day.date)
            (self._late if is_late else self._marks).append(row.mark)
        elif row.facts is not None:
            self._facts.append(dict(row.facts))

    def table(self, record: ProvenRecord) -> RecordTable:
        """Return the record as columns. Errors: DataError"""
        columns = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), len(COLUMNS) + 1).T
        end_utc = begin_of(record.days[-1].date) + DAY_S if record.days else record.start.started_utc
        return RecordTable(
            **dict(zip(COLUMNS, columns[:-1], strict=True)),
            automatic=columns[-1] > 0.0,
            events=tuple(self._events),
            marked=tuple(spans(self._marks, end_utc)),
            late_marks=tuple(self._late),
            facts=tuple(self._facts),
        )


def _cells(tick: SealedTick, day: int) -> tuple[float, ...]:
    reading = tick.readings.get(AIR)
    is_good = reading is not None and reading.quality == ReadingQuality.GOOD.value
    forecast = tick.forecasts.get(FORECASTER)
    duty = tick.echo.heater_duty if tick.echo is not None else None
    return (
        float(tick.seq),
        tick.utc,
        tick.step_s,
        _or_nan(reading.value) if reading is not None and is_good else NAN,
        _or_nan(tick.reference_c),
        duty or 0.0,
        _or_nan(forecast.temp_c.get(str(HORIZON_MIN))) if forecast is not None else NAN,
        float(tick.ticks_skipped),
        float(day),
        float(tick.mode in ("auto", "heat")),
    )


def _or_nan(value: float | None) -> float:
    return NAN if value is None else value
