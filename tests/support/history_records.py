"""Ticks to store, for the tests of the history."""

import math
import sqlite3
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from edge.core.messages import (
    Change,
    Command,
    Decision,
    Echo,
    Estimate,
    Event,
    Forecast,
    Reading,
    ReadingQuality,
    Severity,
    TickRecord,
)
from edge.storage import Storage
from edge.storage.tick_rows import insert_ticks

START_UTC = 1_767_225_600.0
PATIENCE_S = 20.0


@dataclass
class HandClock:
    """Time that stands still unless moved."""

    time_s: float = 1000.0
    wall: float = START_UTC

    def now(self) -> float:
        return self.time_s

    def utc(self) -> float:
        return self.wall

    def wait(self, port: object, wake: object, until_s: float) -> None:
        self.time_s = max(self.time_s, until_s)


@dataclass(frozen=True)
class History:
    """Settings of the history alone."""

    path: str
    retention_days: float = 365.0
    downsample_after_days: float = 30.0
    queue_ticks: int = 50

    @classmethod
    def at(cls, path: Path, **values: Any) -> "History":
        return cls(str(path), **values)


def store(path: Path, *records: TickRecord) -> None:
    """Record these ticks in the history at `path`, as a session of its own."""
    storage = Storage(History.at(path, queue_ticks=max(50, len(records))), HandClock())
    storage.open()
    for record in records:
        storage.write(record)
    assert storage.close(PATIENCE_S)


def add(history: sqlite3.Connection, *records: TickRecord) -> None:
    """Insert these ticks in one transaction."""
    history.execute("BEGIN")
    insert_ticks(history, records, session=1)
    history.execute("COMMIT")


def tick(seq: int, **values: Any) -> TickRecord:
    """A plain tick of a 60 s loop; `values` replace fields."""
    utc = START_UTC + 60.0 * seq
    duty = 0.05 * (seq % 21)
    command = Command(duty, fan_on=seq % 2 == 1, led=0.5)
    record = TickRecord(
        seq=seq,
        time_s=60.0 * seq,
        utc=utc,
        step_s=60.0,
        mode="auto",
        readings={
            "temp_air": Reading("temp_air", 25.0 + 0.1 * (seq % 10), 60.0 * seq, ReadingQuality.GOOD),
            "temp_ambient": Reading("temp_ambient", 21.0, 60.0 * seq, ReadingQuality.GOOD),
            "co2": Reading("co2", None, 60.0 * seq, ReadingQuality.ABSENT),
        },
        estimate=Estimate(25.0, 0.1, 0.001, None, 21.0, 60.0 * seq),
        reference_c=26.0,
        decision=Decision(command, "MPC-P", (25.1, 25.2), {"gap": 0.0, "binding": ["heater_duty"]}),
        wanted=command,
        changes=(),
        sent=command,
        echo=Echo(duty, command.fan_on, 0.5, False, False, "", 60.0 * seq),
        link_up=True,
        events=(),
        ticks_skipped=0,
        late_s=0.001,
        decide_ms=3.2,
        forecasts={"arx": Forecast({1: 25.1, 60: 27.123}, {1: 0.1, 60: 0.75}, outside=False)},
    )
    return replace(record, **values)


def eventful_tick(seq: int) -> TickRecord:
    """A tick with everything that may be odd."""
    return tick(
        seq,
        readings={"temp_air": Reading("temp_air", math.nan, 0.0, ReadingQuality.FAULT)},
        estimate=Estimate(math.nan, math.inf, 0.0, None, 21.0, -math.inf),
        changes=(Change("heater.unknown", "heater_duty", math.nan, 0.0, "air too hot or unknown"),),
        decision=Decision(Command(), "rules", (math.nan,), {"cost": math.inf, "parts": (1, {"a": math.nan})}),
        echo=None,
        events=(
            Event("board.link_lost", Severity.ALARM, "silent for 3 s; Ü", 60.0, START_UTC),
            Event("tick.late", Severity.WARNING, "2 s", 60.0, START_UTC + 1.0),
        ),
        forecasts={
            "arx": Forecast(reason="not a number after step 1"),
            "ham": Forecast({1: 25.123456}, outside=True),
            "pbm": Forecast({1: -1234.5}),
        },
    )
