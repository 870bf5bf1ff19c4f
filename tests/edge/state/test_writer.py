"""edge/state/writer.py and edge/formats/state_document.py: values survive, whole or not at all."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from history_records import tick

from edge.config.loading import default
from edge.config.settings import Settings
from edge.core.clock import RealClock
from edge.core.errors import DataError
from edge.forecasts.skill import ErrorPair, SkillState
from edge.formats.atomic_file import read_document as read
from edge.formats.atomic_file import write_document as write
from edge.safety.memory import SafetyMemory
from edge.state.store import LIMITS, SKILL, STANDING, StoredValue, restore
from edge.state.writer import ANSWERS_MAX, SAVE_S, HourlySink, StandingSink, StateWriter
from edge.tick.orders import Operation


def writer_at(path: Path, pause_s: float = 0.0, encode: Callable[[Any], Any] = dict) -> StateWriter[Any]:
    """A writer of a dictionary."""
    stored = StoredValue(
        dict, "a test", "its end", lambda settings: path, encode, dict, lambda settings, why: {}, pause_s
    )
    return StateWriter(stored, default())


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    write(path, {"mode": "off"})
    write(path, {"mode": "heat"})
    assert read(path) == {"mode": "heat"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["state.json"]


def test_nothing_written_is_none(tmp_path: Path) -> None:
    assert read(tmp_path / "state.json") is None


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\x00\xff", '{"a": 1'])
def test_a_broken_file_is_told_with_its_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=r"state\.json"):
        read(path)


def test_the_writer_ends_with_the_newest_values(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    writer = writer_at(path)
    for number in range(50):
        writer.save({"number": number})
    writer.close()
    assert read(path) == {"number": 49}


def test_a_write_that_fails_is_counted_and_the_next_one_tried(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "state.json"
    writer = writer_at(path)
    writer.save({"number": 1})
    writer.close()
    assert writer.failures == 1
    assert "missing" in writer.last_error


def test_an_answer_comes_when_the_values_are_on_disk_and_not_before(tmp_path, monkeypatch):
    path, may_write, answers = tmp_path / "state.json", threading.Event(), queue.SimpleQueue()

    def slowly(path: Path, values: dict[str, Any]) -> None:
        may_write.wait(5.0)
        write(path, values)

    monkeypatch.setattr("edge.state.writer.write_document", slowly)
    writer = writer_at(path)
    for number in (1, 2, 3):  # one of these is never written; all are answered by a newer one on disk
        writer.save({"number": number}, lambda error: answers.put((error, read(path)["number"])))
    time.sleep(0.05)
    assert answers.empty()
    may_write.set()
    found = [answers.get(timeout=5.0) for _ in range(3)]
    writer.close()
    assert all(error == "" for error, _ in found)
    assert all(on_disk >= number for number, (_, on_disk) in zip((1, 2, 3), found, strict=True))


def test_a_failed_write_is_answered_with_its_reason_and_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr("edge.state.writer.RETRY_S", 0.02)
    path, answers = tmp_path / "missing" / "state.json", queue.SimpleQueue()
    writer = writer_at(path)
    writer.save({"number": 1}, answers.put)
    assert "missing" in answers.get(timeout=5.0)
    path.parent.mkdir()
    deadline = time.monotonic() + 5.0
    while writer.last_error and time.monotonic() < deadline:
        time.sleep(0.01)
    assert read(path) == {"number": 1} and answers.empty()
    writer.close()


def test_a_value_that_the_disk_refused_is_on_disk_after_the_end_once_the_disk_recovers(tmp_path):
    path, answers = tmp_path / "missing" / "state.json", queue.SimpleQueue()
    writer = writer_at(path)
    writer.save({"stop": True}, answers.put)
    assert "missing" in answers.get(timeout=5.0)
    path.parent.mkdir()
    writer.close()  # long before RETRY_S is over
    assert read(path) == {"stop": True}


def test_a_disk_that_refuses_to_the_last_does_not_hold_up_the_end(tmp_path):
    writer = writer_at(tmp_path / "missing" / "state.json")
    writer.save({"stop": True})
    writer.close()
    assert writer.failures >= 1
    assert "state-file" not in {thread.name for thread in threading.enumerate()}


def test_answers_that_wait_for_a_disk_that_hangs_are_bounded_and_each_is_given(tmp_path, monkeypatch):
    may_write = threading.Event()
    monkeypatch.setattr("edge.state.writer.write_document", lambda path, values: may_write.wait(5.0))
    writer = writer_at(tmp_path / "state.json")
    answers: list[str] = []
    for n in range(ANSWERS_MAX + 50):
        writer.save({"n": n}, answers.append)
    assert 48 <= answers.count("the disk does not answer") <= 50
    may_write.set()
    writer.close()
    assert len(answers) == ANSWERS_MAX + 50


def test_a_card_is_spared_and_the_newest_is_written_at_the_end(tmp_path, monkeypatch):
    written: list[int] = []
    monkeypatch.setattr("edge.state.writer.write_document", lambda path, values: written.append(values["n"]))
    writer = writer_at(tmp_path / "state.json", pause_s=60.0)
    for n in range(50):
        writer.save({"n": n})
        time.sleep(0.002)
    assert len(written) == 1
    writer.close()
    assert len(written) == 2
    assert written[-1] == 49


def test_limits_that_cannot_be_written_hold_up_no_order(tmp_path: Path) -> None:
    (tmp_path / "limits.json").mkdir()
    place, answers = settings(tmp_path), queue.SimpleQueue()
    sink = StandingSink(StateWriter(STANDING, place, LIMITS), RealClock())
    sink.save(Operation("MPC", emergency_stop=True), SafetyMemory(), answers.put)
    assert "limits.json" in answers.get(timeout=5.0)
    assert "limits.json" in sink.faults()["state.unwritten"]
    sink.writer.close()
    assert restore(STANDING, place).operation.emergency_stop


def test_a_bug_of_a_codec_is_answered_and_the_next_value_is_written(tmp_path: Path) -> None:
    path, answers = tmp_path / "state.json", queue.SimpleQueue()
    writer = writer_at(path, encode=lambda value: {"number": 1 / value["number"]})
    writer.save({"number": 0}, answers.put)
    assert "division by zero" in answers.get(timeout=5.0)
    writer.save({"number": 2}, answers.put)
    assert answers.get(timeout=5.0) == ""
    writer.close()
    assert read(path) == {"number": 0.5}


# the forecasts' scores outlive a kill, but for the last hour

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
