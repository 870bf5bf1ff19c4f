"""edge/state/writer.py: the forecasts' scores outlive a kill, but for the last hour."""

from dataclasses import replace
from pathlib import Path

from history_records import tick

from edge.config.loading import default
from edge.config.settings import Settings
from edge.forecasts.skill import ErrorPair, SkillState
from edge.state.store import SKILL, restore
from edge.state.writer import SAVE_S, HourlySink

KEY = ("ham", 3, "persistence")


def scored(count: int) -> SkillState:
    return SkillState(pairs={KEY: ErrorPair(("1.0", "-"), count, 0.1, 0.4)})


def settings(folder: Path) -> Settings:
    return replace(default(), state_file=str(folder / "state.json"))


def count_in(folder: Path) -> int:
    return restore(SKILL, settings(folder)).pairs[KEY].scored


def test_scores_are_saved_every_hour_and_at_the_end(tmp_path: Path) -> None:
    now = [scored(0)]
    keeping = HourlySink(SKILL, settings(tmp_path), lambda: now[0])
    for count, time_s in enumerate((0.0, SAVE_S - 1.0, SAVE_S, SAVE_S + 60.0)):
        now[0] = scored(count)
        keeping.write(tick(count + 1, time_s=time_s))
    keeping._writer.close()  # a kill: all that was handed over is on disk, what came later is not
    assert count_in(tmp_path) == 2
    again = HourlySink(SKILL, settings(tmp_path), lambda: scored(5))
    again.close()
    assert count_in(tmp_path) == 5


def test_without_a_file_scores_begin_anew(tmp_path: Path) -> None:
    assert restore(SKILL, settings(tmp_path)) == SkillState()
