"""`greenhouse setup`: the dialogue with scripted answers, interrupted anywhere, at boards of every kind."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from edge.__main__ import main
from edge.app import setup as steps
from edge.app.setup import QUESTIONS, SetupAnswers
from edge.board import board_session, output_check, serial_port
from edge.board.output_check import CHECKS, OutputRefused
from edge.board.serial_port import FoundPort, SerialPort
from edge.commands import setup as command
from edge.config import loading
from edge.core.errors import RequestError
from edge.twin.twin_file import read_twin_file
from firmware_protocol.messages import Capability, ResetCause
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_samples import Samples
from tests.support.broker import PATIENCE_S, wait_for
from tests.support.virtual_board import VirtualBoard, virtual_board

pytest_plugins = ["rig_places"]

BOX = ["150 l", "100", "exhaust", "68", "polycarbonate:8mm", "1.7", "", "15", "30", "22"]
OUTPUTS = ["skip", "yes", "yes", "yes", "skip"]  # heater; fan and its question; light; valve
SCRIPT = [*OUTPUTS, *BOX]
ANSWERS = {
    "port": "PORT",
    "volume_m3": 0.027,
    "heater_w": 40.0,
    "fan_role": "none",
    "wall": "",
    "step_s": 30.0,
    "min_c": 10.0,
    "max_c": 35.0,
    "reference_c": 25.0,
}


class SilentSession:
    """A session with a board that obeys; no line."""

    block_bytes: bytes | None = None

    def __init__(self, path: str) -> None:
        self.path = path
        parts = Capability.LED | Capability.VALVE
        self.hello = BoardConfig(capabilities=parts, report_period_s=2.0).hello(0, ResetCause.POWER_ON, 1)

    def __enter__(self) -> "SilentSession":
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def state(self) -> Any:
        names = ("heater_steps", "fan_on", "led_pct", "tripped")
        cause = SimpleNamespace(name="COMMANDED")
        return SimpleNamespace(**dict.fromkeys(names, 0), heater_off_cause=cause)

    def block(self) -> bytes | None:
        return self.block_bytes

    def wire_parts(self) -> list[int]:
        return []

    def report(self) -> Any:
        return Samples().report(5)


Person = Callable[..., tuple[int, str]]


@pytest.fixture
def silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board without a line whose light alone shows its effect at a sensor."""
    monkeypatch.setattr(command, "BoardSession", SilentSession)
    monkeypatch.setattr(command, "run_check", lambda session, check, say: check.signal == "light" or None)
    monkeypatch.setattr(steps, "SYSTEMD", Path("/none"))


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path) -> Person:
    """Run the command; its lines are typed one by one, an exception is raised, a function called."""

    def run(typed: list[Any], *words: str, port: str = "PORT") -> tuple[int, str]:
        rest: Iterator[Any] = iter(typed)

        def read(prompt: str) -> str:
            print(prompt)
            line = next(rest, EOFError())
            if isinstance(line, BaseException):
                raise line
            return str(line() if callable(line) else line)

        monkeypatch.setattr("builtins.input", read)
        own = ["--port", port] if port else []
        code = main(["setup", "--config", str(folder / "edge.yaml"), *own, *words])
        assert next(rest, None) is None, "lines that nobody asked for"
        out, errors = capsys.readouterr()
        assert [line for line in out.splitlines() if len(line) > 80] == []
        return code, out + errors

    return run


def files(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def test_the_dialogue_writes_both_files(silent: None, person: Person, folder: Path) -> None:
    code, out = person(SCRIPT)
    assert code == 0 and "greenhouse commission" in out
    settings = loading.load(folder / "edge.yaml")
    assert settings.board.port == "PORT"
    assert (settings.reference.min_c, settings.reference.max_c, settings.reference.reference_c) == (
        15,
        30,
        22,
    )
    assert settings.control.controller == "rules"  # the packaged models are of another box
    assert settings.sensor_health.sample_period_s == 2.0  # the board's own
    twin = read_twin_file(folder / "twin.yaml")
    assert twin.geometry["volume_m3"].value == pytest.approx(0.15)
    assert twin.effects["wall_loss"]["UA"].rel_sd == 0.3
    assert set(files(folder)) == {"edge.yaml", "twin.yaml"}  # nothing is left over


@pytest.mark.parametrize("end", [EOFError(), KeyboardInterrupt()], ids=["end of input", "Ctrl-C"])
@pytest.mark.parametrize("place", range(len(SCRIPT)))
def test_a_setup_that_is_interrupted_goes_on_there(
    silent: None, person: Person, folder: Path, end: BaseException, place: int
) -> None:
    code, out = person([*SCRIPT[:place], end])
    assert code == (2 if isinstance(end, EOFError) else 130)
    assert "setup.json" in out
    assert set(files(folder)) == {"setup.json"}
    begin = 1 if place == 2 else place  # the question after a test belongs to it: both are done again
    assert person(SCRIPT[begin:], port="")[0] == 0
    assert loading.load(folder / "edge.yaml").reference.max_c == 30.0
    assert set(files(folder)) == {"edge.yaml", "twin.yaml"}


def test_outputs_of_another_board_are_checked_anew(silent: None, person: Person, folder: Path) -> None:
    person(SCRIPT[:9])
    code, _ = person(SCRIPT[:5] + SCRIPT[9:], port="ANOTHER")
    assert code == 0 and loading.load(folder / "edge.yaml").board.port == "ANOTHER"


def test_answers_of_an_interrupted_setup_can_be_forgotten(silent: None, person: Person) -> None:
    person(SCRIPT[:9])
    assert person(SCRIPT, "--anew")[0] == 0


BAD = {
    "volume_m3": ["", "0.15", "1500 m3", "0.01 l", "-3 l", "nan l", "big"],
    "heater_w": ["", "0", "100 kW", "100 V", "-5"],
    "fan_role": ["", "blow", "Exhaust"],
    "fan_m3_h": ["", "0", "68 furlongs", "1e5", "999999"],
    "wall": ["paper:1mm", "steel", "steel:1"],
    "wall_area_m2": ["", "1000", "0", "1.7 ft2"],
    "step_s": ["0", "601", "2 h", "-1"],
    "min_c": ["", "4", "46", "60 F", "nan"],
    "max_c": ["", "15", "14", "40", "45"],
    "reference_c": ["", "14.9", "30.1", "inf"],
}


@pytest.mark.parametrize("key", BAD)
def test_an_answer_without_sense_is_refused_and_asked_for_again(
    silent: None, person: Person, folder: Path, key: str
) -> None:
    place = len(OUTPUTS) + [question.key for question in QUESTIONS].index(key)
    code, out = person([*SCRIPT[:place], *BAD[key], *SCRIPT[place:]])
    assert code == 0
    assert out.count("Not taken: ") == len(BAD[key])


def test_no_example_is_taken_silently(silent: None, person: Person) -> None:
    """An empty line is an answer only where the question says so."""
    assert [q.key for q in QUESTIONS if q.empty is not None] == ["wall", "step_s"]
    assert all("Enter:" in q.text for q in QUESTIONS if q.empty is not None)


def test_a_box_without_fan_is_not_asked_for_its_flow(silent: None, person: Person, folder: Path) -> None:
    code, _ = person([*OUTPUTS, "27l", "40", "none", "", "60", "15", "30", "22"])
    assert code == 0
    assert read_twin_file(folder / "twin.yaml").fan_role == "none"
    assert read_twin_file(folder / "twin.yaml").effects["wall_loss"]["UA"].fit


# What is there already.


def test_files_that_differ_are_shown_and_stay_under_another_name(
    silent: None, person: Person, folder: Path
) -> None:
    (folder / "edge.yaml").write_text("# mine\ncontrol: {controller: PID}\nmqtt: {enabled: true}\n")
    (folder / "edge.yaml").chmod(0o640)
    (folder / "twin.yaml").write_text("sample_s: 30\n")
    code, out = person([*SCRIPT, "yes", "yes"])
    assert code == 0
    assert "reference.max_c: 38.0 -> 30.0" in out and "-sample_s: 30" in out
    settings = loading.load(folder / "edge.yaml")
    assert settings.mqtt.enabled and settings.control.controller == "PID"
    before = {name.partition(".before-")[0]: text for name, text in files(folder).items() if "before" in name}
    assert before.keys() == {"edge.yaml", "twin.yaml"} and before["edge.yaml"].startswith("# mine")
    assert {path.stat().st_mode & 0o777 for path in folder.glob("edge.yaml*")} == {0o640}


def test_a_file_that_is_not_to_be_replaced_stays(silent: None, person: Person, folder: Path) -> None:
    (folder / "edge.yaml").write_text("# mine\n")
    code, out = person([*SCRIPT, "no"])
    assert code == 2 and "stays as it is" in out
    assert files(folder)["edge.yaml"] == "# mine\n"
    assert set(files(folder)) == {"edge.yaml", "twin.yaml", "setup.json"}
    code, _ = person(["yes"])  # later
    assert code == 0 and loading.load(folder / "edge.yaml").box.twin == str(folder / "twin.yaml")


def test_settings_name_a_twin_file_that_the_service_finds_from_any_folder(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    code, _ = person(SCRIPT, "--config", "edge.yaml")
    assert code == 0 and loading.load(folder / "edge.yaml").box.twin == str(folder / "twin.yaml")


def test_settings_never_name_a_twin_file_that_was_not_written(
    silent: None, person: Person, folder: Path
) -> None:
    (folder / "twin.yaml").write_text("sample_s: 30\n")
    code, _ = person([*SCRIPT, "no"])
    assert code == 2 and set(files(folder)) == {"twin.yaml", "setup.json"}


def test_settings_that_would_not_work_are_not_written(silent: None, person: Person, folder: Path) -> None:
    """By the checks of `greenhouse check-config`."""
    (folder / "edge.yaml").write_text("history: {path: /}\n")
    code, out = person(SCRIPT)
    assert code == 2 and "history.path: /: is a folder" in out
    assert files(folder)["edge.yaml"] == "history: {path: /}\n"


def test_a_wrong_edge_yaml_is_refused_before_any_question(person: Person, folder: Path) -> None:
    (folder / "edge.yaml").write_text("contrl: {}\n")
    code, out = person([])
    assert code == 2 and "did you mean 'control'?" in out


def test_a_damaged_file_of_answers_is_refused(silent: None, person: Person, folder: Path) -> None:
    (folder / "setup.json").write_text('{"max_c": 300}')
    code, out = person([])
    assert code == 2 and "setup.json: max_c: 300 °C is not below" in out


def test_a_folder_that_is_missing_or_closed_is_refused(
    person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out = person([], "--config", str(folder / "none" / "edge.yaml"))
    assert code == 2 and "is missing; `sudo sh deploy/install.sh`" in out
    monkeypatch.setattr(os, "access", lambda *_: False)
    code, out = person([])
    assert code == 2 and "this user cannot write there" in out


# Boards.


def test_without_a_board_the_person_plugs_one_in(
    silent: None, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[list[FoundPort]] = [[], [], [FoundPort("/dev/ttyACM0", "Arduino Mega")]]
    monkeypatch.setattr(command, "find_ports", lambda: found.pop(0))
    code, out = person(["", "", *SCRIPT], port="")
    assert code == 0 and out.count("No board is found") == 2 and "Arduino Mega" in out


def test_of_two_boards_the_person_chooses(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = [FoundPort("/dev/ttyACM0", "3D printer"), FoundPort("/dev/ttyUSB0", "Nano")]
    monkeypatch.setattr(command, "find_ports", lambda: both)
    code, out = person(["3", "nano", "", "2", *SCRIPT], port="")
    assert code == 0 and "1  /dev/ttyACM0: 3D printer" in out
    assert loading.load(folder / "edge.yaml").board.port == "/dev/ttyUSB0"


def test_a_board_without_a_configuration_ends_the_setup(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SilentSession, "block_bytes", b"\xff" * 144)
    code, out = person([])
    assert code == 2 and "greenhouse board configure FILE" in out
    assert files(folder) == {}


def test_a_refused_test_is_tried_again_or_left_out(
    silent: None, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(session: object, test: object, say: object) -> None:
        raise OutputRefused("the air temperature is not good")

    monkeypatch.setattr(command, "run_check", refuse)
    code, out = person(["yes", "again", "skip", "skip", "skip", "skip", *BOX])
    assert code == 0 and out.count("Not checked: the air temperature is not good.") == 2


def test_an_output_without_effect_is_named_at_the_end(
    silent: None, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "run_check", lambda session, test, say: False)
    code, out = person(["yes", "again", "no", "skip", "skip", "skip", *BOX])
    assert code == 0 and "no effect was seen of: Heater" in out
    assert out.count("No effect is seen by the sensor") == 2


def test_a_line_that_is_lost_in_a_test_ends_the_setup(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose(session: object, test: object, say: object) -> None:
        raise RequestError("PORT: the port is gone")

    monkeypatch.setattr(command, "run_check", lose)
    code, out = person(["yes"])
    assert code == 2 and "the board turns all off by itself within 3 s" in out
    assert json.loads(files(folder)["setup.json"]) == {"port": "PORT", "outputs": {}}


def test_ports_of_usb_adapters_are_found_and_have_lasting_names(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = ["/dev/ttyUSB1", "/dev/ttyS0", "/dev/ttyACM0", "/dev/ttyAMA0"]
    found = [SimpleNamespace(device=device, description="board") for device in devices]
    monkeypatch.setattr(serial_port.list_ports, "comports", lambda: found)
    assert [port.path for port in serial_port.find_ports()] == ["/dev/ttyACM0", "/dev/ttyUSB1"]
    monkeypatch.setattr(serial_port, "BY_ID", folder / "by-id")
    device = folder / "ttyACM0"
    device.touch()
    assert serial_port.lasting_name(str(device)) == str(device)
    (folder / "by-id").mkdir()
    (folder / "by-id" / "usb-Arduino-123").symlink_to(device)
    assert serial_port.lasting_name(str(device)) == str(folder / "by-id" / "usb-Arduino-123")


# The service.


@pytest.mark.parametrize(
    ("systemd", "unit", "user", "said"),
    [
        (False, False, 0, "systemd does not run here"),
        (True, False, 0, "sudo sh deploy/install.sh"),
        (True, True, 1000, "only root starts it"),
    ],
)
def test_where_the_service_cannot_be_started_the_command_is_shown(
    silent: None,
    person: Person,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    systemd: bool,
    unit: bool,
    user: int,
    said: str,
) -> None:
    monkeypatch.setattr(steps, "SYSTEMD", folder if systemd else folder / "none")
    monkeypatch.setattr(steps, "UNIT_FILE", folder if unit else folder / "none")
    monkeypatch.setattr(os, "geteuid", lambda: user)
    _, out = person(SCRIPT)
    assert said in out and "\n  sudo systemctl enable --now greenhouse\n" in out


@pytest.mark.parametrize(("works", "said"), [("true", "The service runs."), ("false", "It did not start")])
def test_root_starts_the_service_where_asked_to(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch, works: str, said: str
) -> None:
    systemctl = folder / "bin" / "systemctl"
    systemctl.parent.mkdir()
    systemctl.write_text(f'#!/bin/sh\necho "$@" >> {folder}/bin/log\n{works}\n')
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", str(systemctl.parent), prepend=os.pathsep)
    monkeypatch.setattr(steps, "SYSTEMD", folder)
    monkeypatch.setattr(steps, "UNIT_FILE", folder)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    code, out = person([*SCRIPT, "yes"])
    assert code == 0 and said in out
    log = (folder / "bin" / "log").read_text().splitlines()
    assert log == ["enable greenhouse", "restart greenhouse"][: 2 if works == "true" else 1]


# From a file of answers.


def unattended(person: Person, folder: Path, *words: str, **changes: Any) -> tuple[int, str]:
    answers = {key: value for key, value in {**ANSWERS, **changes}.items() if value is not None}
    (folder / "answers.json").write_text(json.dumps(answers))
    return person([], "--from-answers", str(folder / "answers.json"), *words, port="")


def test_answers_from_a_file_ask_nothing_and_drive_nothing(
    silent: None, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(command, "run_check")
    code, out = unattended(person, folder)
    assert code == 0 and "Not checked: heater, fan, led, valve" in out
    settings = loading.load(folder / "edge.yaml")
    assert settings.control.step_s == 30.0 and settings.control.controller == "rules"
    assert read_twin_file(folder / "twin.yaml").sample_s == 30.0
    assert (folder / "answers.json").exists()


def test_the_same_answers_again_change_nothing(silent: None, person: Person, folder: Path) -> None:
    unattended(person, folder)
    before = files(folder)
    code, out = unattended(person, folder)
    assert code == 0 and out.count("stays as it is") == 2 and files(folder) == before


def test_other_answers_replace_files_only_where_that_is_said(
    silent: None, person: Person, folder: Path
) -> None:
    unattended(person, folder)
    code, out = unattended(person, folder, max_c=33.0)
    assert code == 2 and "edge.yaml: stays as it is" in out
    code, _ = unattended(person, folder, "--replace", max_c=33.0)
    assert code == 0 and loading.load(folder / "edge.yaml").reference.max_c == 33.0


@pytest.mark.parametrize("key", sorted(ANSWERS))
def test_a_missing_answer_is_named(silent: None, person: Person, folder: Path, key: str) -> None:
    code, out = unattended(person, folder, **{key: None})
    assert code == 2 and f"missing: {key}" in out
    assert "edge.yaml" not in files(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("volume_m3", 1500.0),
        ("wall", "air:1mm"),
        ("max_c", 41.0),
        ("outputs", {"fan": "maybe"}),
        ("step_s", 0),
    ],
)
def test_a_wrong_answer_in_a_file_is_named(
    silent: None, person: Person, folder: Path, key: str, value: Any
) -> None:
    code, out = unattended(person, folder, **{key: value})
    assert code == 2 and f"answers.json: {key}" in out


def test_a_file_of_answers_holds_what_was_answered(folder: Path) -> None:
    answers = SetupAnswers(port="a", outputs={"fan": "works"}, wall="", step_s=60.0)
    steps.write_answers(folder / "setup.json", answers)
    assert steps.read_answers(folder / "setup.json", loading.default()) == answers


# The virtual board, in real time.


@pytest.mark.slow
def test_the_dialogue_with_a_board_at_its_line(
    board: VirtualBoard, person: Person, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output_check, "SAMPLES", 2)  # they come once a second
    monkeypatch.setitem(CHECKS, "fan", replace(CHECKS["fan"], seconds=1.0))
    code, out = person(SCRIPT, port=str(board.port))
    assert code == 0 and "Its effect is seen." in out and "Air temperature" in out
    settings = loading.load(folder / "edge.yaml")
    assert settings.board.port == str(board.port) and settings.sensor_health.sample_period_s == 1.0
    assert not any(board.truth()["pins"].values())


@pytest.mark.slow
def test_a_busy_port_is_said_and_tried_again(
    board: VirtualBoard, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = SerialPort(str(board.port), board_session.BAUDRATE)

    def stop_the_daemon() -> str:
        daemon.close()
        return ""

    code, out = person([stop_the_daemon, EOFError()], port=str(board.port))
    assert code == 2 and "`systemctl stop greenhouse` gives it" in out
    assert "Air temperature" in out  # it was greeted then


@pytest.mark.slow
def test_a_setup_that_ends_in_the_middle_of_a_test_leaves_nothing_driven(folder: Path) -> None:
    ends = {signal.SIGINT: 130, signal.SIGKILL: -signal.SIGKILL, signal.SIGHUP: -signal.SIGHUP}
    with ThreadPoolExecutor(len(ends)) as at_once:
        for end in [at_once.submit(end_a_setup, folder / key.name, key, code) for key, code in ends.items()]:
            end.result()


def end_a_setup(folder: Path, end: signal.Signals, code: int) -> None:
    """End the dialogue of a board of its own while the heater is checked."""
    folder.mkdir()
    with virtual_board(folder, "--real-time") as board:
        words = ["setup", "--config", str(folder / "edge.yaml"), "--port", str(board.port)]
        command = [sys.executable, "-m", "edge", *words]
        with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdin is not None
                process.stdin.write("yes\n")
                process.stdin.flush()
                wait_for(lambda: heats(board) or process.poll() is not None)
                process.send_signal(end)
                assert process.wait(PATIENCE_S) == code
            finally:
                process.kill()
        wait_for(lambda: not heats(board))
    assert not (folder / "edge.yaml").exists()


def heats(board: VirtualBoard) -> bool:
    return bool(board.truth()["pins"]["heater_relay"])
