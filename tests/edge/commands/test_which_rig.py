"""edge/commands/which_rig.py and edge/app/demo_folders.py: orders reach the rig that is meant, or none."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main
from edge.app import demo_folders
from edge.app.demo_folders import make_demo_folder, running_demos
from edge.commands import which_rig
from edge.commands.which_rig import history_of, socket_of
from edge.config.settings import ControlSocketSettings, HistorySettings
from edge.core.errors import DataError, RequestError
from edge.sockets.control_socket import ControlSocket

NO_OPTION = argparse.Namespace(socket=None)
Listen = Callable[[Path], Path]


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without a rig and without demos; `rig.sock` would be the rig's socket."""
    rig = ControlSocketSettings(str(tmp_path / "rig.sock"))
    history = HistorySettings(path=str(tmp_path / "rig.db"))
    monkeypatch.setattr(demo_folders, "demos_directory", lambda: tmp_path / "demos")
    monkeypatch.setattr(which_rig, "ControlSocketSettings", lambda: rig)
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
    assert main(["mode", "auto"]) == 0


def test_beside_a_rig_no_demo_gets_an_order_by_chance_and_a_stop_reaches_the_rig(
    machine: Path, listen: Listen
) -> None:
    path = demo(listen)
    # The rig's daemon is down, but there is a rig.
    (machine / "edge.yaml").write_text(f"control_socket: {{path: {machine / 'rig.sock'}}}\n")
    with pytest.raises(RequestError, match=rf"--socket .*rig\.sock or --socket {path}"):
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
