"""A state that may cost an hour: written every hour, when a record calls for it, and at the end."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from edge.core.messages import TickRecord
from edge.state.state_file import StateWriter

SAVE_S = 3600.0  # what a kill may cost


class StateKeeping:
    """A sink of tick records that saves in a thread of its own.

    state : now, None while there is nothing to save; calls : whether a record is a reason to save at once
    """

    def __init__(
        self,
        state: Callable[[], dict[str, Any] | None],
        path: Path,
        calls: Callable[[TickRecord], bool] = lambda record: False,
    ) -> None:
        self._state, self._calls = state, calls
        self._writer = StateWriter(path)
        self._saved_s: float | None = None

    def write(self, record: TickRecord) -> None:
        """Never waits."""
        if self._saved_s is None:
            self._saved_s = record.time_s  # what was read at start is on disk
        if self._calls(record) or record.time_s - self._saved_s >= SAVE_S:
            self._saved_s = record.time_s
            self._save()

    def faults(self) -> Mapping[str, str]:
        """None that need telling: without the file what it holds begins anew."""
        return {}

    def close(self) -> None:
        """Save, then end the thread."""
        self._save()
        self._writer.close()

    def _save(self) -> None:
        state = self._state()
        if state is not None:
            self._writer.save(state)
