"""State that outlives the process: standing orders and latched trips, in one file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from edge.config.settings import Settings
from edge.core.controller_names import CONTROLLERS
from edge.core.messages import TickRecord
from edge.safety.supervisor import SafetyMemory, memory_from_dict, memory_to_dict
from edge.state import state_file
from edge.state.state_file import Answered, StateFileBroken, StateWriter
from edge.tick import orders_json as orders
from edge.tick.orders import Operation


@dataclass(frozen=True, slots=True)
class StandingState:
    """The state that outlives the process."""

    operation: Operation
    memory: SafetyMemory
    broken: str = ""  # why the state file could not be understood


def read_standing(path: Path, settings: Settings) -> StandingState:
    """Standing orders and latched trips; an unreadable file means emergency stop, not a fresh start."""
    fresh = Operation(controller=settings.control.controller)
    try:
        values = state_file.read(path)
        if values is None:
            return StandingState(fresh, SafetyMemory())
        operation = orders.from_dict(values["operation"])
        if operation.controller not in CONTROLLERS:
            raise StateFileBroken(f"{path}: unknown controller {operation.controller!r}")
        return StandingState(operation, memory_from_dict(values["safety"]))
    except Exception as error:  # whatever it is: a rig that does not know its orders stands still
        stopped = Operation(controller=settings.control.controller, emergency_stop=True)
        reason = str(error) if isinstance(error, StateFileBroken) else f"{path}: {error!r}"
        return StandingState(stopped, SafetyMemory(), reason)


@dataclass(slots=True)
class StateSink:
    """Saves standing orders in their own thread; tells the loop when the disk does not take them."""

    writer: StateWriter

    def save(self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
        """Never waits; `answered` as in `StateWriter.save`."""
        values = {"operation": orders.to_dict(operation), "safety": memory_to_dict(memory)}
        self.writer.save(values, answered)

    def write(self, record: TickRecord) -> None:
        """Ticks are none of its business."""

    def faults(self) -> Mapping[str, str]:
        """Return the last failed write, until one succeeds."""
        return {"state.unwritten": self.writer.last_error} if self.writer.last_error else {}
