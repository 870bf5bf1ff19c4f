"""edge/forecasts/skill_state.py: the forecasts' scores outlive a kill, but for the last hour."""

from pathlib import Path

import pytest
from history_records import tick

from edge.forecasts.skill import ErrorPair, SkillState
from edge.forecasts.skill_state import read_skill, skill_keeping
from edge.state.keeping import SAVE_S

KEY = ("ham", 3, "persistence")


def scored(count: int) -> SkillState:
    return SkillState(pairs={KEY: ErrorPair(("1.0", "-"), count, 0.1, 0.4)})


def count_in(path: Path) -> int:
    return read_skill(path).pairs[KEY].scored


def test_scores_are_saved_every_hour_and_at_the_end(tmp_path: Path) -> None:
    path, now = tmp_path / "skill.json", [scored(0)]
    keeping = skill_keeping(lambda: now[0], path)
    for count, time_s in enumerate((0.0, SAVE_S - 1.0, SAVE_S, SAVE_S + 60.0)):
        now[0] = scored(count)
        keeping.write(tick(count + 1, time_s=time_s))
    keeping._writer.close()  # a kill: all that was handed over is on disk, what came later is not
    assert count_in(path) == 2
    again = skill_keeping(lambda: scored(5), path)
    again.close()
    assert count_in(path) == 5


@pytest.mark.parametrize("content", [None, "", "{", '{"pairs": 3}', "[]"])
def test_without_a_readable_file_scores_begin_anew(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "skill.json"
    if content is not None:
        path.write_text(content)
    assert read_skill(path) == SkillState()
