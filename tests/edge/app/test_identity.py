"""A daemon's identity: the board that it drives, its entry among the running rigs, files that are its own."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from edge.app import running_rigs, setup
from edge.app.daemon import Daemon
from edge.board.virtual_rig import settings_in
from edge.config import loading
from edge.config.settings import ControlSocketSettings, MqttSettings, Settings
from edge.core.clock import RealClock
from edge.core.errors import ConfigError
from edge.core.messages import TickRecord
from edge.tick.status import LoopStatus, status_json
from training.lab import Lab

RULES = "control: {controller: rules}\nreference: {kind: constant, reference_c: 30}\ndrift: {enabled: false}"


def settings_of(folder: Path) -> Settings:
    return settings_in(folder, loading.parse(RULES))


def three_ticks(folder: Path, settings: Settings | None = None) -> tuple[list[TickRecord], dict[str, object]]:
    """Run a daemon at a virtual board; return its ticks, and its status after the last one."""
    statuses: list[LoopStatus] = []
    with Lab(
        settings or settings_of(folder),
        board="here",
        folder=folder,
        on_tick=lambda record: statuses.append(lab._daemon.status()),
    ) as lab:
        lab.run(ticks=3)
    return lab.history, status_json(statuses[-1])


def keys(records: list[TickRecord]) -> list[str]:
    return [event.key for record in records for event in record.events]


def test_a_rig_pins_the_board_that_it_sees_first_and_drives_no_other(tmp_path: Path) -> None:
    pin = tmp_path / "board.json"
    records, status = three_ticks(tmp_path)
    assert json.loads(pin.read_text()) == {"board_id": 1}
    assert records[-1].sent.heater_duty > 0.0 and "board.pinned" in keys(records)
    pin.write_text(json.dumps({"board_id": 0x7777}))
    records, status = three_ticks(tmp_path)
    assert [record.sent.heater_duty for record in records] == [0.0] * 3
    assert "board.foreign" in keys(records) and "board.link_down" not in keys(records)
    assert status["foreign_board"] == f"board 1 answers, board {0x7777} is pinned"
    assert status["conditions"] == {"board.foreign": "another board is at the port"}
    assert json.loads(pin.read_text()) == {"board_id": 0x7777}


@pytest.mark.parametrize("broken", ["{", '{"board_id": "1"}', "{}", "[]"])
def test_a_rig_whose_pin_is_lost_says_that_it_pins_again(tmp_path: Path, broken: str) -> None:
    (tmp_path / "board.json").write_text(broken)
    records, _ = three_ticks(tmp_path)
    assert "board.pinned" in keys(records) and records[-1].link_up


@pytest.mark.parametrize("shared", ["history", "state", "both by a link"])
def test_a_second_daemon_on_the_same_files_is_refused_and_a_kill_frees_them(
    tmp_path: Path, shared: str
) -> None:
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
    first, second = (settings_of(folder) for folder in folders)
    if shared == "both by a link":
        (tmp_path / "link").symlink_to(folders[0])
        second = replace(settings_of(tmp_path / "link"), control_socket=second.control_socket)
    elif shared == "state":
        second = replace(second, state_file=first.state_file)
    else:
        second = replace(second, history=first.history)
    key = "state_file" if shared == "state" else "history.path"
    refused = pytest.raises(ConfigError, match=f"{key}: .*: another daemon uses this file")
    with Daemon(first, RealClock()), refused:
        Daemon(second, RealClock()).__enter__()
    assert not Path(second.control_socket.path).exists()
    program = (
        "import sys, time; from pathlib import Path; from edge.formats.atomic_file import hold_lock\n"
        "with hold_lock(Path(sys.argv[1])): print(flush=True); time.sleep(60)"
    )
    locked = f"{first.state_file if shared == 'state' else first.history.path}.lock"
    with subprocess.Popen([sys.executable, "-c", program, locked], stdout=subprocess.PIPE) as held:
        try:
            assert held.stdout is not None
            held.stdout.readline()
            with refused:
                Daemon(second, RealClock()).__enter__()
        finally:
            held.kill()
    with Daemon(second, RealClock()):
        pass


def test_a_disk_that_refuses_the_lock_does_not_end_control(tmp_path: Path) -> None:
    settings = settings_of(tmp_path)
    for path in (settings.history.path, settings.state_file):
        Path(f"{path}.lock").mkdir()
    with Daemon(settings, RealClock()):
        pass


def test_a_daemon_is_registered_from_its_start_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = ControlSocketSettings(str(tmp_path / "run" / "control.sock"))
    monkeypatch.setattr(running_rigs, "ControlSocketSettings", lambda: run)
    settings = settings_of(tmp_path)
    umask = os.umask(0o077)
    for _ in ("makes the folder", "finds it"):
        with Daemon(settings, RealClock()) as daemon:
            (rig,) = running_rigs.known_rigs()
            assert rig.socket == settings.control_socket.path and rig.name == settings.mqtt.rig
            assert "daemon.unregistered" not in events_at_start(daemon)
        assert list((tmp_path / "run").iterdir()) == []
        os.umask(umask)
    assert (tmp_path / "run").stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("part", ["the folder", "the entry"])
def test_a_daemon_that_cannot_register_says_how_a_stop_finds_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    run = ControlSocketSettings(str(tmp_path / "run" / "control.sock"))
    monkeypatch.setattr(running_rigs, "ControlSocketSettings", lambda: run)
    if part == "the folder":
        (tmp_path / "run").write_text("no folder")
    else:
        monkeypatch.setattr(running_rigs, "write_atomically", refuse)
    settings = settings_of(tmp_path)
    with Daemon(settings, RealClock()) as daemon:  # the folder is another user's
        assert list(running_rigs.known_rigs()) == []
        said = events_at_start(daemon)["daemon.unregistered"]
        assert str(tmp_path / "run") in said and f"--socket {settings.control_socket.path} only" in said


def events_at_start(daemon: Daemon) -> dict[str, str]:
    assert daemon._loop is not None
    return {event.key: event.text for event in daemon._loop._events.take()}


def refuse(path: Path, text: str) -> None:
    raise PermissionError(13, "Permission denied", str(path))


@pytest.mark.parametrize(
    ("host", "machine", "pattern"),
    [
        ("pi", "0123\n", "pi-[0-9a-f]{6}"),
        ("Gewächshaus 2.lan", "0123\n", "Gew-chshaus-2-[0-9a-f]{6}"),
        ("", "0123\n", "rig-[0-9a-f]{6}"),
        ("x" * 64, "", "x{50}-[0-9a-f]{6}"),
        ("pi", None, "pi-[0-9a-f]{6}"),  # a container
    ],
)
def test_a_new_rig_is_named_by_its_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, host: str, machine: str | None, pattern: str
) -> None:
    monkeypatch.setattr(setup, "gethostname", lambda: host)
    monkeypatch.setattr(setup, "MACHINE_ID", tmp_path / "machine-id")
    if machine is not None:
        (tmp_path / "machine-id").write_text(machine)
    new = settings_of(tmp_path)
    name = setup.rig_name(new)
    assert re.fullmatch(pattern, name) and MqttSettings(rig=name)
    assert (setup.rig_name(new) == name) == (machine is not None)
    (tmp_path / "machine-id").write_text("a clone of the image")
    assert setup.rig_name(new) != name
    named = replace(new, mqtt=replace(new.mqtt, rig="mine"))
    published = replace(new, mqtt=replace(new.mqtt, enabled=True))
    assert [setup.rig_name(before) for before in (named, published)] == ["mine", "greenhouse-1"]
    Path(new.state_file).write_text("{}")  # it has run under its name
    assert setup.rig_name(new) == "greenhouse-1"


@pytest.mark.parametrize(("rig", "told"), [("greenhouse-1", True), ("pi-0123ab", False)])
def test_a_rig_that_keeps_the_default_name_says_so(tmp_path: Path, rig: str, told: bool) -> None:
    settings = settings_of(tmp_path)
    mqtt = replace(settings.mqtt, enabled=True, host="127.0.0.1", port=1, rig=rig)
    records, _ = three_ticks(tmp_path, replace(settings, mqtt=mqtt))
    assert ("mqtt.default_name" in keys(records)) == told
