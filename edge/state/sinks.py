"""Sinks of tick records that save state: at once, or every hour and when a record calls for it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic

from edge.config.settings import Settings
from edge.core.messages import DriftState, TickRecord
from edge.safety.memory import SafetyMemory
from edge.state.codecs import StandingState
from edge.state.store import StoredValue, Value
from edge.state.writer import StateWriter
from edge.tick.orders import Operation
from edge.tick.rig import Answered

SAVE_S = 3600.0  # what a kill may cost


@dataclass(slots=True)
class StandingSink:
    """Saves standing orders and trips at once; reports when the disk does not take them."""

    writer: StateWriter[StandingState]

    def save(self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
        """Never waits; `answered` as in `StateWriter.save`."""
        self.writer.save(StandingState(operation, memory), answered)

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
        state = record.drift.state if record.drift else DriftState.UNKNOWN
        turned = DriftState.DISAGREES in (state, self._state) and state is not self._state
        self._state = state
        return turned
