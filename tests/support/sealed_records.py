"""A history of some days, a key, and the record that is sealed of it."""

import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from history_records import START_UTC, store, tick

from edge.bundle.sign import generate_key
from edge.core.messages import Command, Echo, Event, Forecast, Reading, ReadingQuality, Severity, TickRecord
from edge.evidence.chain import GRACE_S, extend_chain, seal_chain, start_chain
from edge.evidence.chain_files import DAY_S
from edge.evidence.marks import EvidenceMark, add_mark

STEP_S = 1800.0
TICKS_A_DAY = int(DAY_S / STEP_S)
NOON_UTC = START_UTC + 0.5 * DAY_S


def sealed_tick(seq: int, utc: float, air_c: float | None = 25.0, **values: Any) -> TickRecord:
    """A tick of a slow loop that holds 25 degC; no air: the reading is a fault."""
    quality = ReadingQuality.GOOD if air_c is not None else ReadingQuality.FAULT
    base: dict[str, Any] = {
        "utc": utc,
        "step_s": STEP_S,
        "readings": {"temp_air": Reading("temp_air", air_c, 0.0, quality)},
        "reference_c": 25.0,
        "echo": Echo(0.5 if air_c is not None else 0.0, False, 0.0, False, False, "", 0.0),
        "sent": Command(),
        "forecasts": {"pbm": Forecast({30: 25.0})},
    }
    return tick(seq, **{**base, **values})


def event(key: str, utc: float, text: str = "") -> Event:
    return Event(key, Severity.ALARM, text, 0.0, utc)


@dataclass
class RecordRig:
    """A rig whose record begins at noon of the first day."""

    folder: Path
    history: Path = field(init=False)
    chain: Path = field(init=False)
    key: Path = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.history, self.chain = self.folder / "history.db", self.folder / "evidence"
        self.key = self.folder / "rig.pem"
        generate_key(self.key)

    def live(
        self,
        days: float,
        change: Callable[[TickRecord], TickRecord | None] = lambda record: record,
        marks: Sequence[EvidenceMark] = (),
    ) -> "RecordRig":
        """Record from noon on, beginning the record first; `change` returns None for a lost tick."""
        store(self.history, sealed_tick(1, NOON_UTC - STEP_S))
        start_chain(self.chain, self.history, self.key, NOON_UTC)
        for mark in marks:
            add_mark(self.chain, mark)
        count = round(days * TICKS_A_DAY)
        records = [sealed_tick(2 + k, NOON_UTC + k * STEP_S) for k in range(count)]
        store(self.history, *(one for record in records if (one := change(record)) is not None))
        return self

    def extend(self, days: float) -> list[Any]:
        """Extend as the timer would at that many days after the midnight before the start."""
        facts = {"software": "0.1.0", "files": {"edge.yaml": "control: {}\n"}}
        return extend_chain(self.chain, self.history, self.key, facts, START_UTC + days * DAY_S + GRACE_S)[0]

    def seal(self, days: float, name: str = "record.zip") -> Path:
        """Extend and seal at that moment; return the archive."""
        self.extend(days)
        out = self.folder / name
        seal_chain(self.chain, self.key, out, START_UTC + days * DAY_S + GRACE_S)
        return out

    def forget(self, first_seq: int, last_seq: int, reason: str = "") -> None:
        """Delete ticks from the history, with a reason in its gaps or without one."""
        with closing(sqlite3.connect(self.history)) as database:
            database.execute("DELETE FROM ticks WHERE seq BETWEEN ? AND ?", (first_seq, last_seq))
            if reason:
                row = (first_seq, last_seq, START_UTC, reason)
                database.execute("INSERT INTO gaps VALUES (?, ?, ?, ?)", row)
            database.commit()
