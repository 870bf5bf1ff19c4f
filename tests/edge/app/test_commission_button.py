"""Commissioning by the service: when a press is refused, and the daemons before, in and after the tests."""

import copy
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from edge.app import commission_button
from edge.app.box import BEFORE, description_of
from edge.app.commission_button import CommissionDesk, refusal
from edge.app.daemon import Daemon
from edge.app.nightly_diagnosis import LATE, BackgroundFailure
from edge.board.virtual_rig import settings_in
from edge.config.settings import BoxSettings, Settings
from edge.core.errors import DataError
from edge.formats.run_file import read_run
from edge.sockets.client import request
from edge.state.store import STANDING, restore
from edge.state.writer import StateWriter
from edge.tick.orders import FanMode, Operation
from edge.tick.status import status_json
from edge.twin.new_file import BoxDescription, text
from tests.support.broker import wait_for
from training.lab import InProcessBoard

TWIN = Path("training/results/paper_case/interpolation/twin.yaml").resolve()
READY = {
    "operation": {"emergency_stop": False, "maintenance_until_utc": None, "mode": "auto"},
    "tick": {"utc": 100.0, "readings": {"temp_air_c": {"value": 21.0, "quality": "good"}}},
    "trips": [],
    "echo": {"tripped": False},
    "link_up": 1,
}
REACH = "in a room of 21.0 °C, 2.0 h of full heat reach 40 °C; to hold takes 5.0 W then for each K"


@pytest.fixture
def rig(tmp_path: Path) -> Settings:
    """A rig with a described box and a key."""
    (tmp_path / "box.yaml").write_text(text(BoxDescription(0.15, 100.0, "exhaust", 68.0)))
    (tmp_path / "rig.pem").write_text("key")
    placed = settings_in(tmp_path, Settings(timezone="UTC"))
    bundle = replace(placed.bundle, signing_key=str(tmp_path / "rig.pem"))
    return replace(placed, bundle=bundle, box=BoxSettings(str(tmp_path / "box.yaml")))


def changed(path: str, value: object) -> dict:
    """READY with another value at a place such as `tick.utc`."""
    status = copy.deepcopy(READY)
    *keys, last = path.split(".")
    place = status
    for key in keys:
        place = place[key]
    place[last] = value
    return status


def test_a_rig_that_is_ready_is_not_refused(rig: Settings) -> None:
    assert refusal(rig, READY) == ""


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("operation.emergency_stop", True, "emergency stop"),
        ("operation.maintenance_until_utc", 101.0, "hands are in the box"),
        ("operation.mode", "off", "mode off"),
        ("operation.mode", "manual", "mode manual"),
        ("trips", ["over_temperature"], "tripped: over_temperature"),
        ("echo", None, "the board does not answer"),
        ("echo.tripped", True, "the board has tripped"),
        ("link_up", 0, "the board does not answer"),
        ("tick.readings", {}, "no good air temperature"),
        ("tick.readings.temp_air_c.quality", "stale", "no good air temperature"),
        ("tick", None, "no tick"),
    ],
)
def test_a_rig_that_is_held_off_or_blind_is_refused(
    rig: Settings, path: str, value: object, said: str
) -> None:
    assert said in refusal(rig, changed(path, value))


def test_what_is_missing_is_told_before_two_hours_are_spent(rig: Settings, tmp_path: Path) -> None:
    assert "bundle.signing_key" in refusal(replace(rig, bundle=replace(rig.bundle, signing_key="")), READY)
    assert "bundle.path" in refusal(replace(rig, bundle=replace(rig.bundle, path="")), READY)
    assert "greenhouse setup" in refusal(replace(rig, box=BoxSettings(heater_w=100.0)), READY)
    (tmp_path / "rig.pem").unlink()
    assert "no such key" in refusal(rig, READY)
    (tmp_path / "box.yaml").write_text("{")
    with pytest.raises(DataError):
        refusal(rig, READY)


def test_a_learned_box_is_learned_anew_from_its_description(tmp_path: Path) -> None:
    path = tmp_path / "box.yaml"
    path.write_bytes(TWIN.read_bytes())
    assert description_of(path).to_fit() == []
    (tmp_path / f"box.yaml{BEFORE}").write_text(text(BoxDescription(0.03, 40.0, "none")))
    assert description_of(path).geometry["heater_max_w"].value == 40.0


class LearningProcess:
    """Ends as a test says, in the place of a process that learns."""

    def __init__(self, code: object = 0, said: str = REACH) -> None:
        self.code, self.said, self.words = code, said, []

    def run(self, words, log, patience_s):
        self.words = list(words)
        log.write_text(self.said + "\n")
        if isinstance(self.code, Exception):
            raise self.code
        return self.code

    def close(self) -> None:
        pass


class Service:
    """The loop of `greenhouse run` on a board in this process; `at_tick` acts in the tests."""

    def __init__(self, rig: Settings, process: LearningProcess, at_tick=lambda service, count: None) -> None:
        self.rig, self.board, self.at_tick = rig, InProcessBoard(1), at_tick
        self.desk = CommissionDesk(rig, Path("edge.yaml"), process, minutes=20.0)
        self.deciders: list[str] = []
        self.texts: list[str] = []
        self.replies: list[dict] = []
        self.count = 0

    def ask(self, **request: object) -> dict:
        self.replies.append(
            self.desk.answer({"do": "commission", **request}, lambda: status_json(self.daemon.status()))
        )
        return self.replies[-1]

    def run(self) -> None:
        with self._daemon(self._press) as self.daemon:
            self.daemon.run()
        if self.desk.is_due:
            self.desk.make_tests(self.board, self._tick, open_port=self.board.open)
        with self._daemon(self._stop_after_two) as self.daemon:
            self.daemon.run()
        self.desk.close()

    def _daemon(self, after_tick) -> Daemon:
        return Daemon(self.rig, self.board, after_tick, open_port=self.board.open, commissioning=self.desk)

    def _press(self, tick) -> None:
        self.deciders.append(tick.decision.controller)
        if len(self.deciders) == 2 and not self.ask()["ok"]:
            self.daemon.stop()

    def _tick(self, tick) -> None:
        self.count += 1
        self.deciders.append(tick.decision.controller)
        self.texts.append(self.desk._state.text)
        self.at_tick(self, self.count)

    def _stop_after_two(self, tick) -> None:
        self.deciders.append(tick.decision.controller)
        if self.deciders[-2] == tick.decision.controller:
            self.daemon.stop()


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for an answer, so the daemon ends at once."""
    monkeypatch.setattr(commission_button, "BEGIN_AFTER_S", 0.0)


@pytest.mark.slow
def test_a_press_tests_the_box_learns_and_gives_control_back(rig: Settings, tmp_path: Path) -> None:
    process = LearningProcess()
    service = Service(rig, process)
    service.run()
    before, after = service.deciders[0], service.deciders[-1]
    assert before == after == "MPC-P" and set(service.deciders) == {"MPC-P", "step-tests"}
    assert service.replies[0]["commissioning"]["phase"] == "tests"
    assert {"tests 1 of 20 min", "tests 19 of 20 min"} <= set(service.texts)
    wait_for(lambda: service.desk._state.phase == "done", "the end of learning")
    assert "of full heat reach 40 °C" in service.desk._state.text
    run = Path(process.words[process.words.index("--from-run") + 1])
    assert process.words[0] == "commission" and len(read_run(run)) == 120
    assert not (tmp_path / "state.json").exists() or restore(STANDING, rig).operation.controller == "MPC-P"


@pytest.mark.slow
def test_orders_from_before_come_back_after_a_stop_in_the_tests(rig: Settings) -> None:
    """An order writes the state file in the middle of the tests, whose daemon has no models."""
    answers: list[dict] = []

    def order() -> None:
        answers.append(request(Path(rig.control_socket.path), {"do": "maintenance", "minutes": 0}))

    def stop(service: Service, count: int) -> None:
        if count == 2:
            threading.Thread(target=order).start()
        if count > 10 and answers:
            service.ask(end=True)

    standing = replace(
        restore(STANDING, rig), operation=Operation("MPC", fan_mode=FanMode.ON, reference_c=25.0)
    )
    writer = StateWriter(STANDING, rig)
    writer.save(standing)
    writer.close()
    service = Service(rig, LearningProcess(), stop)
    service.run()
    assert service.desk._state.phase == "ended" and "run.csv is kept" in service.desk._state.text
    assert answers[0]["ok"] and service.deciders[-1] == "MPC"
    operation = restore(STANDING, rig).operation
    assert (operation.controller, operation.fan_mode, operation.reference_c) == ("MPC", FanMode.ON, 25.0)


@pytest.mark.parametrize(
    ("process", "phase", "said"),
    [
        (LearningProcess(1, f"{REACH}\nrefused: off by 2 K"), "refused", "refused: off by 2 K"),
        (
            LearningProcess(2, "greenhouse: no key"),
            "refused",
            "not learned: greenhouse: no key",
        ),
        (LearningProcess(LATE, ""), "refused", "not learned within 4 h"),
        (LearningProcess(BackgroundFailure("no unit")), "refused", "not learned: no unit"),
    ],
)
def test_what_comes_of_learning_is_said(
    rig: Settings, tmp_path: Path, process: LearningProcess, phase: str, said: str
) -> None:
    desk = CommissionDesk(rig, tmp_path / "edge.yaml", process)
    seen: list[str] = []
    desk.serve(lambda: None, lambda state: seen.append(state["text"]))
    desk._learn(tmp_path)
    assert desk._state.phase == phase and desk._state.text.startswith(said)
    assert seen == ["idle", desk._state.text]


def test_a_second_press_is_refused_and_does_not_change_what_is_shown(rig: Settings) -> None:
    desk = CommissionDesk(rig, Path("edge.yaml"), LearningProcess())
    assert desk.answer({"do": "commission"}, lambda: READY)["ok"]
    reply = desk.answer({"do": "commission"}, lambda: READY)
    assert "runs already: tests 0 of 120 min" in reply["error"]
    assert desk.is_due and desk._state.phase == "tests"
    desk.signal()
    assert not desk.is_due and desk.is_over


def test_a_refused_press_says_why_where_the_person_looks(rig: Settings) -> None:
    desk = CommissionDesk(rig, Path("edge.yaml"), LearningProcess())
    reply = desk.answer({"do": "commission"}, lambda: changed("trips", ["fan_no_effect"]))
    assert not reply["ok"] and not desk.is_due
    assert desk._state.text == "refused: tripped: fan_no_effect; clear it first"
    assert "no step tests run" in desk.answer({"do": "commission", "end": True}, lambda: READY)["error"]
    assert "unknown key" in desk.answer({"do": "commission", "now": 1}, lambda: READY)["error"]
