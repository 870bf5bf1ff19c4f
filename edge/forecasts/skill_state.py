"""The forecasts' live skill on disk: read at start, written every hour and at the end."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from edge.forecasts.skill import ErrorPair, SkillState, Width
from edge.state import state_file
from edge.state.keeping import StateKeeping
from edge.state.state_file import StateFileBroken


def to_dict(state: SkillState) -> dict[str, Any]:
    """Return a list of lists for each part, keys first."""
    return {
        "pairs": [
            [*key, *pair.versions, pair.scored, pair.mae_k, pair.reference_mae_k]
            for key, pair in state.pairs.items()
        ],
        "widths": [
            [*key, width.version, width.half_width_k, width.scored, width.covered]
            for key, width in state.widths.items()
        ],
    }


def from_dict(values: Mapping[str, Any]) -> SkillState:
    """Errors: ValueError for anything that `to_dict` does not write."""
    try:
        pairs = {
            (str(name), int(horizon), str(reference)): ErrorPair(
                (str(version), str(other)), _count(scored), _size(mae_k), _size(reference_mae_k)
            )
            for name, horizon, reference, version, other, scored, mae_k, reference_mae_k in values["pairs"]
        }
        widths = {
            (str(name), int(horizon)): Width(str(version), _above_0(half), _count(scored), _size(covered))
            for name, horizon, version, half, scored, covered in values["widths"]
        }
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no state of the forecasts' skill: {error!r}") from error
    return SkillState(pairs, widths)


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _size(value: Any) -> float:
    if isinstance(value, bool) or not 0.0 <= value < math.inf:  # NaN fails too
        raise ValueError(f"{value!r} is no size")
    return float(value)


def _above_0(value: Any) -> float:
    if not _size(value) > 0.0:
        raise ValueError(f"{value!r} is not above 0")
    return float(value)


def read_skill(path: Path) -> SkillState:
    """Read the scores of an earlier process. Where they are unreadable they
    begin anew, which endangers nothing.
    """
    try:
        return from_dict(state_file.read(path) or {"pairs": [], "widths": []})
    except (StateFileBroken, ValueError):
        return SkillState()


def skill_keeping(state: Callable[[], SkillState], path: Path) -> StateKeeping:
    """Return the sink that saves the scores."""
    return StateKeeping(lambda: to_dict(state()), path)
