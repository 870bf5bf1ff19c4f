"""The forecasts' live skill on disk: read at start, written every hour and at the end."""

from collections.abc import Callable, Mapping
from pathlib import Path

from edge import state_file
from edge.forecasts.skill import SkillState
from edge.forecasts.skill_json import from_dict, to_dict
from edge.messages import TickRecord
from edge.state_file import StateFileBroken, StateWriter

SAVE_S = 3600.0  # what a kill may cost


def read_skill(path: Path) -> SkillState:
    """Of the process before; where it can't be read the scores begin anew, which endangers nothing."""
    try:
        return from_dict(state_file.read(path) or {"pairs": [], "widths": []})
    except (StateFileBroken, ValueError):
        return SkillState()


class SkillKeeping:
    """A sink of tick records that saves the scores in a thread of its own."""

    def __init__(self, state: Callable[[], SkillState], path: Path) -> None:
        self._state = state
        self._writer = StateWriter(path)
        self._saved_s: float | None = None

    def write(self, record: TickRecord) -> None:
        """Never waits."""
        if self._saved_s is None:
            self._saved_s = record.time_s  # what was read at start is on disk
        if record.time_s - self._saved_s >= SAVE_S:
            self._saved_s = record.time_s
            self._save()

    def faults(self) -> Mapping[str, str]:
        """None that need telling: without the file the scores begin anew."""
        return {}

    def close(self) -> None:
        """Save, then end the thread."""
        self._save()
        self._writer.close()

    def _save(self) -> None:
        self._writer.save(to_dict(self._state()))
