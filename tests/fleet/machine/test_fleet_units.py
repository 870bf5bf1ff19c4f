"""The fleet's units: systemd has nothing against them, little is exposed, they start what `up` does."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from unit_calls import call_groups, resolved

from edge.core.errors import RequestError
from fleet.machine import service, units
from fleet.machine.engines import PACKAGES, engines
from fleet.machine.places import FOLDER, USER, FleetMachine, places_of
from fleet.machine.setting_up import set_up
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT
from tests.support.page_process import listens

EXPOSURE_MAX = 2.5
HERE = ROOT / "deploy" / "fleet"


def usual() -> dict[str, str]:
    try:
        return units.usual_units()
    except RequestError as error:
        pytest.skip(str(error))


def test_the_units_of_the_repository_are_those_that_up_writes() -> None:
    written = {path.name: path.read_text() for path in HERE.iterdir() if path.suffix != ".md"}
    assert written == usual()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_has_nothing_to_say_against_them_and_little_is_exposed(tmp_path: Path) -> None:
    for name, text in usual().items():
        (tmp_path / name).write_text(text.replace(units.PYTHON, shutil.which("true") or ""))
    places = {**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"}
    for name in usual():
        words = ["systemd-analyze", "verify", "--man=no", str(tmp_path / name)]
        done = subprocess.run(words, capture_output=True, text=True, env=places)
        assert (done.returncode, done.stderr) == (0, "")
        if name.endswith(".service"):
            words = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(tmp_path / name)]
            out = subprocess.run(words, capture_output=True, text=True, check=True).stdout
            score = re.search(r"Overall exposure level for \S+: ([0-9.]+)", out)
            assert score is not None
            assert float(score[1]) <= EXPOSURE_MAX, (name, score[1])


@pytest.fixture
def systemctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A systemctl that writes down how it was called."""
    calls, program = tmp_path / "calls", tmp_path / "bin" / "systemctl"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$@" >> {calls}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    return calls


def test_services_are_started_and_every_unit_is_removed_at_the_end(tmp_path: Path, systemctl: Path) -> None:
    usual()
    machine = FleetMachine(str(tmp_path / "data"), names=("localhost",))
    folder = tmp_path / "units"
    folder.mkdir()
    (folder / "other.service").write_text("")
    service.start(list(engines(places_of(FOLDER), machine)), machine, places_of(FOLDER), folder)
    names = {path.name for path in folder.iterdir()} - {"other.service"}
    assert names == set(usual())
    reload, enable, restart = systemctl.read_text().splitlines()
    assert reload == "daemon-reload"
    assert set(enable.split()) == {"enable", *names}
    assert set(restart.split()) == {"restart", *names}
    assert service.end(machine, folder)
    assert set(systemctl.read_text().splitlines()[3].split()) == {"disable", "--now", *names}
    assert [path.name for path in folder.iterdir()] == ["other.service"]
    assert not service.end(machine, folder)


def test_the_end_of_all_takes_the_services_user_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, program = tmp_path / "calls", tmp_path / "bin" / "userdel"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$@" >> {calls}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    known = {"somebody", USER}

    def ask(user: str) -> str:
        if user not in known:
            raise KeyError(user)
        return user

    monkeypatch.setattr(service.pwd, "getpwnam", ask)
    for user in ("somebody", USER):  # the first is of a fleet that was only tried
        machine = FleetMachine(str(tmp_path / user / "data"), user, names=("localhost",))
        places = places_of(tmp_path / user)
        Path(machine.data).mkdir(parents=True)
        service.erase(places, machine)
        assert not places.folder.exists()
    known.clear()
    service.erase(places_of(tmp_path / USER), FleetMachine(str(tmp_path / "none"), names=("localhost",)))
    assert calls.read_text() == f"{USER}\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_engines_run_with_the_rights_and_calls_of_their_units() -> None:
    """As another user who reads the folder by its group alone; every call that a unit refuses fails."""
    usual()
    refused = sorted(resolved(["@privileged", "@resources"], call_groups()))
    assert "setpriority" in refused
    inject = f"inject={','.join(f'?{name}' for name in refused)}:error=EPERM"
    with tempfile.TemporaryDirectory(prefix="gh-") as name, ExitStack() as stack:
        Path(name).chmod(0o755)
        places = places_of(Path(name) / "fleet")
        machine = replace(set_up(places, ["localhost"], True, lambda words: None), user="nobody")
        places.write(machine)
        set_up(places, [], True, lambda words: None)
        service.give_files(places, machine)
        # Our own Python may lie where only root goes; the page's calls are those of a rig's page.
        for engine in (each for each in engines(places, machine) if each.command[0] != sys.executable):
            become = ("setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--no-new-privs")
            trace = ("strace", "-f", "-qq", "-o", "/dev/null", "-e", inject)
            log = stack.enter_context((Path(name) / f"{engine.name}.log").open("wb+"))
            process = subprocess.Popen(
                [*become, "--bounding-set=-all", *trace, *engine.command],
                stdout=log, stderr=log, start_new_session=True, env={**os.environ, **engine.environment},
            )  # fmt: skip
            stack.callback(end_group, process)
            wait_for(lambda: listens(engine.port) or process.poll() is not None, engine.name, 60.0)  # noqa: B023
            assert process.poll() is None, Path(log.name).read_text()


def end_group(process: "subprocess.Popen[bytes]") -> None:
    """End a program and the strace around it."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(30.0)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_python_that_services_cannot_reach_is_refused(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    (closed / "python").touch(0o755)
    with pytest.raises(RequestError, match="/opt/greenhouse/venv"):
        service.check_program(closed / "python")


def test_the_installer_brings_every_engine() -> None:
    text = (ROOT / "deploy" / "install-fleet.sh").read_text()
    (named,) = [line for line in text.splitlines() if line.startswith("set -- ")]
    assert set(named.partition("#")[0].split()[2:]) == set(PACKAGES.values())
