"""The writer of one value that survives a restart.

A small JSON file, not the history database: the file must be there when the database is not. A thread of its
own encodes and writes, because a slow disk must not hold up control.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic

from edge.config.settings import Settings
from edge.core.clock import Clock, Moment
from edge.core.messages import DriftState, TickRecord
from edge.formats.atomic_file import write_document
from edge.safety.memory import SafetyMemory
from edge.state.codecs import StandingState
from edge.state.store import StoredValue, Value
from edge.tick.orders import Operation
from edge.tick.rig import Answered

RETRY_S = 10.0  # between two tries to write what a full or read-only disk did not take
ANSWERS_MAX = 200  # that wait for the disk; more come in a flood only


class StateWriter(Generic[Value]):
    """Writes the newest value in a thread of its own; older ones that wait are dropped.

    A value that could not be written is tried again, so that a disk that recovers holds it.
    also : of the same value, written first
    """

    def __init__(self, stored: StoredValue[Value], settings: Settings, *also: StoredValue[Value]) -> None:
        self._documents = [(each.place(settings), each.encode) for each in (*also, stored)]
        self._stored = stored
        self._condition = threading.Condition()
        self._next: Value | None = None
        self._unwritten: Value | None = None  # by the last try
        self._answers: list[Answered] = []
        self._closing = False
        self.failures = 0  # writes that did not reach the disk
        self.last_error = ""  # of the newest write, empty when it succeeded
        self._thread = threading.Thread(target=self._run, name="state-file", daemon=True)
        self._thread.start()

    def save(self, value: Value, answered: Answered | None = None) -> None:
        """Hand over a value that nobody changes any more; never waits, never raises.

        answered : called once, in the writer's thread, when this value or a newer one is on disk (file and
            folder synchronised), or could not be written; behind a disk that hangs the oldest of too many are
            answered at once, in the caller's thread
        """
        oldest = None
        with self._condition:
            self._next = value
            if answered is not None:
                oldest = self._answers.pop(0) if len(self._answers) == ANSWERS_MAX else None
                self._answers.append(answered)
            self._condition.notify()
        if oldest is not None:
            oldest("the disk does not answer")

    def close(self) -> None:
        """Write the newest value, tried once more where the last try failed, then end."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                timeout_s = None if self._unwritten is None else RETRY_S
                self._condition.wait_for(lambda: self._next is not None or self._closing, timeout_s)
                value = self._unwritten if self._next is None else self._next
                self._next = None
                answers, self._answers = self._answers, []
                closing = self._closing
            if value is not None:
                self._write(value, answers)
            with self._condition:
                if closing and self._next is None:
                    return
                self._condition.wait_for(lambda: self._closing, self._stored.pause_s)

    def _write(self, value: Value, answers: list[Answered]) -> None:
        found = ""
        for path, encode in self._documents:
            try:
                write_document(path, encode(value))
            except Exception as error:  # a bug of a codec must not end the thread that saves a stop
                self.failures += 1
                found = str(error) or repr(error)
        self.last_error, self._unwritten = found, value if found else None
        for answered in answers:
            answered(self.last_error)


SAVE_S = 3600.0  # what a kill may cost


@dataclass(slots=True)
class StandingSink:
    """Saves standing orders and trips at once; reports when the disk does not take them."""

    writer: StateWriter[StandingState]
    clock: Clock
    boot_id: str = ""

    def save(self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
        """Never waits; `answered` as in `StateWriter.save`."""
        at = Moment(self.boot_id, self.clock.now(), self.clock.utc())
        self.writer.save(StandingState(operation, memory, at=at), answered)

    def write(self, record: TickRecord) -> None:
        """Nothing to do with a tick."""

    def faults(self) -> Mapping[str, str]:
        """Return the last failed write, until one succeeds."""
        return {"state.unwritten": self.writer.last_error} if self.writer.last_error else {}


class HourlySink(Generic[Value]):
    """Saves a value of which a kill may cost an hour.

    value : now, None while there is nothing to save
    calls : True for a record that is a reason to save at once
    """

    def __init__(
        self,
        stored: StoredValue[Value],
        settings: Settings,
        value: Callable[[], Value | None],
        calls: Callable[[TickRecord], bool] = lambda record: False,
    ) -> None:
        self._value, self._calls = value, calls
        self._writer = StateWriter(stored, settings)
        self._saved_s: float | None = None

    def write(self, record: TickRecord) -> None:
        """Never waits."""
        if self._saved_s is None:
            self._saved_s = record.time_s  # the value read at start is on disk
        if self._calls(record) or record.time_s - self._saved_s >= SAVE_S:
            self._saved_s = record.time_s
            self._save()

    def faults(self) -> Mapping[str, str]:
        """No fault worth a report: without the file the value begins anew."""
        return {}

    def close(self) -> None:
        """Save, then end the thread."""
        self._save()
        self._writer.close()

    def _save(self) -> None:
        value = self._value()
        if value is not None:
            self._writer.save(value)


class DriftTurns:
    """Calls for a save when the measurements begin to disagree with the twin, and when that ends."""

    def __init__(self) -> None:
        self._state = DriftState.UNKNOWN

    def __call__(self, record: TickRecord) -> bool:
        """Return True for the record that enters or leaves DISAGREES; a record without drift is UNKNOWN."""
        state = record.drift.state if record.drift else DriftState.UNKNOWN
        turned = DriftState.DISAGREES in (state, self._state) and state is not self._state
        self._state = state
        return turned
