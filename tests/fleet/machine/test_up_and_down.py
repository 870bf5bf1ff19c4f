"""`greenhouse fleet up --foreground` and `down`: what runs, what stays, what is refused."""

import io
import socket
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.core.errors import RequestError
from edge.core.processes import die_with_parent
from edge.page.access import Role
from fleet.database.base import open_database
from fleet.machine.engines import PACKAGES, engines
from fleet.machine.places import FleetMachine, places_of
from fleet.machine.setting_up import set_up
from fleet.page.people import EVERY, People
from fleet.settings import load
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT
from tests.support.page_process import Client, listens

FLEET = [sys.executable, "-m", "edge", "fleet"]
UP_S = 90.0


def has_engines(folder: Path) -> bool:
    try:
        list(engines(places_of(folder), FleetMachine(names=("localhost",))))
    except RequestError:
        return False
    return True


needs_engines = pytest.mark.skipif(
    not has_engines(Path("any")), reason=f"apt install {' '.join(sorted(set(PACKAGES.values())))}"
)


def command(*words: str) -> "subprocess.CompletedProcess[str]":
    """Run it in a process, for one that might go up."""
    return subprocess.run([*FLEET, *words], cwd=ROOT, capture_output=True, text=True, timeout=90)


def called(*words: str) -> tuple[int, str, str]:
    """Return the exit code of a command, and what it said in both ways."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr("sys.argv", ["greenhouse", "fleet", *words])
        code = main(["fleet", *words])
    return code, out.getvalue(), err.getvalue()


def up(folder: Path) -> "subprocess.Popen[str]":
    """Start a fleet and wait until all of its engines run."""
    with (folder.parent / "up.out").open("w") as out:
        process = subprocess.Popen(
            [*FLEET, "up", "--foreground", "--folder", str(folder)],
            cwd=ROOT, stdout=out, stderr=out, text=True, preexec_fn=die_with_parent,
        )  # fmt: skip
    said = folder.parent / "up.out"
    wait_for(lambda: "all engines run" in said.read_text() or process.poll() is not None, "up", UP_S)
    assert process.poll() is None, said.read_text()
    return process


def children(process: "subprocess.Popen[str]") -> list[int]:
    found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    return [int(number) for number in found.split()]


@needs_engines
def test_a_fleet_goes_up_serves_its_page_and_goes_down_with_its_data_kept(tmp_path: Path) -> None:
    """No engine outlives an `up` that is killed, and the next one goes on."""
    places = places_of(tmp_path / "fleet")
    process = up(places.folder)
    try:
        machine = places.read()
        people = People(open_database(load(places.settings).database))
        people.add("Ann", EVERY, Role.ADMIN, "a good long one")
        browser = Client(f"https://localhost:{machine.ports.web}", str(places.authority))
        entered = browser.post("/api/session", {"name": "Ann", "password": "a good long one"})
        assert entered.ok, entered.text
        wait_for(lambda: browser.get("/api/rigs").json()["broker"], "the page is at the broker")
        assert "Greenhouses" in browser.get("/").text
        # From elsewhere nobody posts alarms, whatever they know.
        token = places.alert_token.read_text()
        posted = browser.post("/api/v2/alerts", [], authorization=f"Bearer {token}")
        assert posted.status_code == 404
        with socket.socket(type=socket.SOCK_DGRAM) as datagrams:  # the one port is TCP's alone
            datagrams.bind(("127.0.0.1", machine.ports.web))
        second = command("up", "--foreground", "--folder", str(places.folder))
        assert (second.returncode, "another `greenhouse fleet up` runs here" in second.stderr) == (2, True)
        pids = children(process)
        assert len(pids) == len(list(engines(places, FleetMachine(names=("localhost",)))))
        process.kill()
        process.wait()
        wait_for(lambda: not [pid for pid in pids if is_running(pid)], "the end of all engines")
        process = up(places.folder)  # with the ports and certificates of before
        pids = children(process)
        code, said, error = called("down", "--folder", str(places.folder))
        assert code == 0, error
        assert "the fleet has ended" in said
        assert f"its data stays in {places.folder}/data" in said
        assert process.wait(60.0) == 0
    finally:
        process.kill()
        process.wait()
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    ports = machine.ports
    assert not [
        port for port in (ports.broker, ports.web, ports.numbers, ports.alerts, ports.page) if listens(port)
    ]
    assert (places.folder / "data" / "fleet.db").exists()
    code, said, error = called("down", "--erase", "--folder", str(places.folder))
    assert code == 0, error
    assert "nothing was running" in said
    assert not places.folder.exists()


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@needs_engines
def test_a_port_that_is_taken_is_named_and_nothing_stays(tmp_path: Path) -> None:
    places = places_of(tmp_path / "fleet")
    machine = set_up(places, [], True, lambda words: None)
    with (tmp_path / "web.log").open("wb") as log:
        own = [sys.executable, "-m", "http.server", "--bind", "127.0.0.1", str(machine.ports.page)]
        other = subprocess.Popen(own, stdout=log, stderr=log, preexec_fn=die_with_parent)
    try:
        wait_for(lambda: listens(machine.ports.page), "another server")
        done = command("up", "--foreground", "--folder", str(places.folder))
    finally:
        other.kill()
        other.wait()
    assert done.returncode == 2
    assert f"port {machine.ports.page} of page is taken" in done.stderr
    assert not listens(machine.ports.broker)


def test_a_folder_of_others_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    for words in (("up", "--foreground"), ("down", "--erase")):
        code, _, error = called(*words, "--folder", str(tmp_path))
        assert code == 2
        assert str(tmp_path) in error
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    code, _, error = called("up", "--foreground", "--folder", str(tmp_path / "file" / "fleet"))
    assert code == 2
    assert error.startswith(f"greenhouse fleet: {tmp_path}/file")
    assert error.count("\n") == 1


def test_set_up_again_keeps_what_is_yours_and_renews_what_is_its(tmp_path: Path) -> None:
    places = places_of(tmp_path / "fleet")
    said: list[str] = []
    set_up(places, ["one.example"], True, said.append)
    kept = {path: path.read_bytes() for path in (places.authority, places.alert_token, places.key("fleet"))}
    places.settings.write_text(places.settings.read_text() + "alarms: {air_max_c: 35}\n")
    before = places.certificate("server").read_bytes()
    set_up(places, [], True, said.append)
    assert places.certificate("server").read_bytes() == before
    assert "> 35" in places.rules.read_text()
    machine = set_up(places, ["two.example"], True, said.append)
    assert machine.names == ("two.example", "localhost", "127.0.0.1")
    assert places.certificate("server").read_bytes() != before
    assert {path: path.read_bytes() for path in kept} == kept
    assert "page.names lacks two.example" in said[-1]


def test_secrets_are_for_their_owner_and_the_authoritys_for_nobody_else(tmp_path: Path) -> None:
    places = places_of(tmp_path / "fleet")
    set_up(places, ["one.example"], True, lambda words: None)
    modes = {path.name: path.stat().st_mode & 0o777 for path in places.folder.iterdir() if path.is_file()}
    assert modes["ca.key"] == 0o600
    assert {modes[name] for name in ("server.key", "fleet.key", "alerts.token")} == {0o640}
