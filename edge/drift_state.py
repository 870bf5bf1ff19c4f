"""The drift monitor's memory on disk: read at start, written at each event, every hour and at the end."""

from collections.abc import Mapping
from pathlib import Path

from edge import state_file
from edge.drift.memory import Memory, from_dict, to_dict
from edge.drift.monitor import DriftMonitor
from edge.messages import DriftState, TickRecord
from edge.state_file import StateFileBroken, StateWriter

SAVE_S = 3600.0  # what a kill may cost


def read_memory(path: Path) -> Memory | None:
    """Of the process before; where it can't be read the test begins anew, which endangers nothing."""
    try:
        values = state_file.read(path)
        return None if values is None else from_dict(values)
    except (StateFileBroken, ValueError):
        return None


class DriftKeeping:
    """A sink of tick records that saves the monitor's memory in a thread of its own."""

    def __init__(self, monitor: DriftMonitor, path: Path) -> None:
        self._monitor = monitor
        self._writer = StateWriter(path)
        self._saved_s = -SAVE_S
        self._state = DriftState.UNKNOWN

    def write(self, record: TickRecord) -> None:
        """Never waits."""
        state = record.drift.state if record.drift else DriftState.UNKNOWN
        turned = DriftState.DISAGREES in (state, self._state) and state is not self._state
        self._state = state
        if turned or record.time_s - self._saved_s >= SAVE_S:
            self._saved_s = record.time_s
            self._save()

    def faults(self) -> Mapping[str, str]:
        """None that need telling: without the file the test begins anew."""
        return {}

    def close(self) -> None:
        """Save, then end the thread."""
        self._save()
        self._writer.close()

    def _save(self) -> None:
        if self._monitor.memory is not None:
            self._writer.save(to_dict(self._monitor.memory))
