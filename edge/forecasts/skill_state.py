"""The forecasts' live skill on disk: read at start, written every hour and at the end."""

from collections.abc import Callable
from pathlib import Path

from edge.forecasts.skill import SkillState
from edge.forecasts.skill_json import from_dict, to_dict
from edge.state import state_file
from edge.state.keeping import StateKeeping
from edge.state.state_file import StateFileBroken


def read_skill(path: Path) -> SkillState:
    """Of the process before; where it can't be read the scores begin anew, which endangers nothing."""
    try:
        return from_dict(state_file.read(path) or {"pairs": [], "widths": []})
    except (StateFileBroken, ValueError):
        return SkillState()


def skill_keeping(state: Callable[[], SkillState], path: Path) -> StateKeeping:
    """The sink that saves the scores."""
    return StateKeeping(lambda: to_dict(state()), path)
