"""edge/commands/which_rig.py and edge/app/running_rigs.py: orders reach the rig that is meant, or none."""

import argparse
import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main
from edge.app import running_rigs
from edge.app.running_rigs import make_demo_folder, running_demos
from edge.board.virtual_rig import settings_in
from edge.commands import orders, which_rig
from edge.commands.which_rig import history_of, rigs_of, socket_of
from edge.config.settings import ControlSocketSettings, HistorySettings, Settings
from edge.core.errors import DataError, RequestError
from edge.sockets.control_socket import ControlSocket
from edge.sockets.stop_file import LEFT, StopFile

NO_OPTION = argparse.Namespace(socket=None)
Listen = Callable[[Path], Path]


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without a rig and without demos; `rig.sock` would be the rig's socket."""
    rig = ControlSocketSettings(str(tmp_path / "rig.sock"))
    history = HistorySettings(path=str(tmp_path / "rig.db"))
    monkeypatch.setattr(running_rigs, "demos_directory", lambda: tmp_path / "demos")
    monkeypatch.setattr(which_rig, "ControlSocketSettings", lambda: rig)
    monkeypatch.setattr(running_rigs, "ControlSocketSettings", lambda: rig)
    monkeypatch.delenv("GREENHOUSE_RIG", raising=False)
    monkeypatch.setattr(which_rig, "HistorySettings", lambda: history)
    monkeypatch.setattr(which_rig, "RIG_CONFIG", tmp_path / "edge.yaml")
    return tmp_path


@pytest.fixture
def listen() -> Iterator[Listen]:
    """Daemons that answer ok to everything."""
    with ExitStack() as stack:

        def at(path: Path) -> Path:
            def post(message: Any, answer: Callable[[dict[str, Any]], None]) -> None:
                answer({"ok": True})

            stack.callback(ControlSocket(path, lambda message: {"ok": True}, post).close)
            return path

        yield at


def demo(listen: Listen) -> Path:
    return listen(make_demo_folder(None) / "control.sock")


def test_without_a_rig_and_a_demo_the_way_to_one_is_named(machine: Path) -> None:
    with pytest.raises(RequestError, match=r"no daemon listens at .*rig\.sock; `greenhouse demo`"):
        socket_of(NO_OPTION)


def test_a_lone_demo_is_found_and_named(
    machine: Path, listen: Listen, capsys: pytest.CaptureFixture[str]
) -> None:
    path = demo(listen)
    assert socket_of(NO_OPTION) == path
    assert f"the demo at {path}, not a real rig" in capsys.readouterr().err
    assert main(["mode", "auto"]) == main(["board", "accept"]) == 0


def test_beside_a_rig_no_demo_gets_an_order_by_chance_and_a_stop_reaches_the_rig(
    machine: Path, listen: Listen
) -> None:
    path = demo(listen)
    # The rig's daemon is down, but there is a rig.
    (machine / "edge.yaml").write_text(f"control_socket: {{path: {machine / 'rig.sock'}}}\n")
    with pytest.raises(RequestError, match=rf"is not known \(.*rig\.sock\), demo \({path}\)"):
        socket_of(NO_OPTION)
    usual = machine / "rig.sock"
    listen(usual)
    with pytest.raises(RequestError, match="more than one rig"):
        socket_of(NO_OPTION)
    assert socket_of(NO_OPTION, urgent=True) == usual
    assert socket_of(argparse.Namespace(socket=path)) == path


def test_the_rigs_own_configuration_says_where_it_listens(machine: Path) -> None:
    (machine / "edge.yaml").write_text("control_socket: {path: /run/other.sock}\n")
    assert which_rig.rig_socket() == Path("/run/other.sock")
    (machine / "edge.yaml").write_text("control_sock: {}\n")
    assert which_rig.rig_socket() == machine / "rig.sock"  # a wrong file must not stop a stop


def test_a_demo_that_has_ended_is_not_found_and_its_history_stays_until_the_next(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = make_demo_folder(None).rename(machine / "demos" / "999999999")  # no such process
    (ended / "history.db").touch()
    assert running_demos() == []
    assert history_of(None) == ended / "history.db"
    make_demo_folder(None)
    assert not ended.exists()
    with pytest.raises(DataError, match="`greenhouse demo` records one"):
        history_of(None)


def test_a_folder_that_the_user_named_is_never_removed(machine: Path) -> None:
    out = machine / "kept"
    make_demo_folder(out)
    (out / "history.db").touch()
    assert history_of(None) == out / "history.db"
    make_demo_folder(None)
    assert (out / "history.db").exists()


def test_a_rigs_history_goes_before_a_demos(machine: Path) -> None:
    (make_demo_folder(None) / "history.db").touch()
    (machine / "rig.db").touch()
    assert history_of(None) == machine / "rig.db"


def test_a_directory_that_others_can_write_is_not_trusted(machine: Path, listen: Listen) -> None:
    demo(listen)
    (machine / "demos").chmod(0o777)
    assert running_demos() == []
    with pytest.raises(RequestError, match="of this user alone"):
        make_demo_folder(None)


def test_a_demo_folder_that_cannot_be_written_names_its_option(machine: Path) -> None:
    for path in ("/proc/xx", "/dev/null"):
        with pytest.raises(RequestError, match=f"--out: {path}: "):
            make_demo_folder(Path(path))


def test_a_demo_folder_too_long_for_a_socket_names_its_option(machine: Path) -> None:
    with pytest.raises(RequestError, match=r"--out: .* too long for a socket"):
        make_demo_folder(machine / ("x" * 81))


def register(machine: Path, name: str, socket: Path, number: int) -> None:
    """A daemon's entry, as its process writes it."""
    values = {"name": name, "socket": str(socket), "stops": str(machine / name / "stops")}
    (machine / f"{number}.rig").write_text(json.dumps(values))


@pytest.fixture
def hangs(tmp_path: Path) -> Iterator[Path]:
    """A daemon that accepts and never answers."""
    path = tmp_path / "hangs.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as silent:
        silent.bind(str(path))
        silent.listen()
        yield path


def test_a_stop_without_a_selection_stops_every_rig_and_leaves_the_stop_where_one_hangs(
    machine: Path,
    listen: Listen,
    hangs: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(orders, "STOP_MAX_S", 0.2)
    register(machine, "stale", machine / "nobody.sock", 1)
    register(machine, "hangs", hangs, 2)
    register(machine, "north", listen(machine / "north.sock"), 3)
    register(machine, "south", listen(machine / "south.sock"), 4)
    listen(machine / "rig.sock")  # of a version that does not register
    path = demo(listen)
    assert main(["emergency-stop"]) == 1
    *stopped, last = capsys.readouterr().out.splitlines()
    assert sorted(stopped) == sorted(
        f"{name}: stopped" for name in ("north", "south", str(machine / "rig.sock"), "demo")
    )
    assert last == f"hangs: {LEFT}"
    assert StopFile(machine / "hangs" / "stops").author() == "the command line"
    assert [main(["emergency-stop", "--rig", name]) for name in ("north", "demo", "hangs")] == [0, 0, 1]
    assert main(["emergency-stop", "--socket", str(path)]) == 0


@pytest.mark.parametrize(
    "entry",
    [
        '{"name": 1}',
        "",
        "[]",
        *(f'{{"name": "x", "socket": "{p}"}}' for p in ("\\u0000", "a\\u0000b", "\\ud800")),
    ],
)
def test_an_entry_that_nobody_can_read_hinders_no_stop(machine: Path, listen: Listen, entry: str) -> None:
    register(machine, "north", listen(machine / "north.sock"), 3)
    (machine / "2.rig").write_text(entry)
    (machine / "1.rig").symlink_to("/dev/zero")
    os.mkfifo(machine / "0.rig")
    assert main(["emergency-stop"]) == 0


def test_a_rig_that_was_killed_gets_the_stop_at_its_next_start(
    machine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (machine / "edge.yaml").write_text(f"control_socket: {{path: {machine / 'rig.sock'}}}\n")
    assert main(["emergency-stop"]) == 1
    assert f"NOT STOPPED: no daemon listens at {machine / 'rig.sock'}" in capsys.readouterr().out
    register(machine, "north", machine / "rig.sock", 1)  # left by a kill; systemd starts it again
    assert main(["emergency-stop"]) == 1
    assert capsys.readouterr().out == f"north: {LEFT}\n"
    assert StopFile(machine / "north" / "stops").author() == "the command line"


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        ([], "no daemon listens at {0}/rig.sock"),
        (["--rig", "box-1"], "no rig named 'box-1' runs on this machine; running: none"),
        (["--socket", "{0}/other.sock"], "no daemon listens at {0}/other.sock"),
    ],
)
def test_a_stop_that_finds_nobody_says_first_that_nothing_was_stopped(
    machine: Path, capsys: pytest.CaptureFixture[str], option: list[str], reason: str
) -> None:
    assert main(["emergency-stop", *(word.format(machine) for word in option)]) == 2
    said = capsys.readouterr().err
    start = "greenhouse emergency-stop: NOTHING WAS STOPPED: "
    assert said.startswith(f"{start}{reason.format(machine)}; say --socket PATH")
    assert "pull the heater's plug" in said and "demo" not in said


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_stop_by_a_user_who_may_not_reach_the_rig_says_so(
    machine: Path, listen: Listen, capsys: pytest.CaptureFixture[str]
) -> None:
    listen(machine / "rig.sock")
    assert main(["emergency-stop"]) == 0  # and all modules are loaded
    for folder in machine.parents[:-1]:
        folder.chmod(folder.stat().st_mode | 0o011)
    machine.chmod(0o700)  # as the package's /run/greenhouse for whoever is not in the group
    os.seteuid(65534)
    try:
        code = main(["emergency-stop"])
    finally:
        os.seteuid(0)
    assert code == 1 and "NOT STOPPED" in (said := capsys.readouterr().out) and "Permission denied" in said


@pytest.mark.parametrize("variable", [True, False])
def test_a_rig_is_selected_by_its_name(
    machine: Path, listen: Listen, monkeypatch: pytest.MonkeyPatch, variable: bool
) -> None:
    for number, name in enumerate(("north", "south", "twice", "twice")):
        register(machine, name, listen(machine / f"{number}.sock"), number)
    with pytest.raises(
        RequestError, match=r"--rig or --socket: north \(.*0\.sock\), south \(.*2\.sock\), twice"
    ):
        socket_of(NO_OPTION)

    def selected(name: str) -> Path:
        monkeypatch.setenv("GREENHOUSE_RIG", name if variable else "other")
        return socket_of(argparse.Namespace(socket=None, rig=None if variable else name))

    assert selected("south") == machine / "1.sock"
    with pytest.raises(RequestError, match=r"no rig named 'west' runs.*; running: north, south, twice"):
        selected("west")
    with pytest.raises(RequestError, match=r"--socket: twice \(.*2\.sock\), twice \(.*3\.sock\)"):
        selected("twice")
    assert socket_of(argparse.Namespace(socket=Path("x"), rig=None)) == Path("x")


def test_an_entry_names_a_daemon_as_long_as_it_listens(machine: Path, listen: Listen) -> None:
    path = listen(machine / "second.sock")
    settings = settings_in(machine, Settings())
    settings = replace(settings, control_socket=replace(settings.control_socket, path=str(path)))
    entry = running_rigs.register(settings)
    assert entry is not None
    (found,) = rigs_of(NO_OPTION)
    assert (found.name, found.socket) == (settings.mqtt.rig, str(path))
    assert (found.stops, found.is_demo) == (str(machine / "stops"), False)
    path.unlink()
    with pytest.raises(RequestError, match="no daemon listens"):
        rigs_of(NO_OPTION)


def test_root_leaves_a_stop_with_the_rights_of_who_named_its_folder(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    acted: list[str] = []

    @contextmanager
    def as_owner(path: str) -> Iterator[bool]:
        acted.append(path)
        yield True
        acted.append("end")

    monkeypatch.setattr(orders, "as_owner", as_owner)
    monkeypatch.setattr(StopFile, "leave", lambda self, author: acted.append(author))
    register(machine, "north", machine / "rig.sock", 1)
    assert main(["emergency-stop", "--rig", "north"]) == 1
    assert acted == [str(machine / "1.rig"), "the command line", "end"]
