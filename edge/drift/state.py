"""The drift monitor's memory on disk: read at start, written at each event, every hour and at the end."""

from pathlib import Path
from typing import Any

from edge.core.messages import DriftState, TickRecord
from edge.drift.memory import DriftMemory, from_dict, to_dict
from edge.drift.monitor import DriftMonitor
from edge.state import state_file
from edge.state.keeping import StateKeeping
from edge.state.state_file import StateFileBroken


def read_memory(path: Path) -> DriftMemory | None:
    """Read the memory of an earlier process. Where it is unreadable the test
    begins anew, which endangers nothing.
    """
    try:
        values = state_file.read(path)
        return None if values is None else from_dict(values)
    except (StateFileBroken, ValueError):
        return None


def drift_keeping(monitor: DriftMonitor, path: Path) -> StateKeeping:
    """Return the sink that saves the monitor's memory."""

    def memory() -> dict[str, Any] | None:
        return None if monitor.memory is None else to_dict(monitor.memory)

    return StateKeeping(memory, path, _Turns())


class _Turns:
    """A check for the first and the last record that disagrees."""

    def __init__(self) -> None:
        self._state = DriftState.UNKNOWN

    def __call__(self, record: TickRecord) -> bool:
        state = record.drift.state if record.drift else DriftState.UNKNOWN
        turned = DriftState.DISAGREES in (state, self._state) and state is not self._state
        self._state = state
        return turned
