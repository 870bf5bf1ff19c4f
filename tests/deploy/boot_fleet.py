"""Tries docs/fleet.md on a fresh Debian 12 that boots under systemd, with a rig that has its papers.

    python tests/deploy/boot_fleet.py [--architecture amd64] [--kvm]

The rig is this software's daemon with a virtual board, on the same machine as another user. Run it as root,
from the checkout: what is tried is its commit. It keeps its output in bench/results/boot_fleet.txt.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import yaml
from boot_container import Container
from boot_machine import (
    AMD64,
    ARM64,
    KVM,
    Machine,
    MachineArchitecture,
    ShellError,
    make_disk,
    make_tree,
    run,
)
from boot_network import NETWORK, give_network, give_packages
from boot_report import BootReport, wait_for

from bench.header import RESULTS, ROOT, header
from fleet.machine.units import PREFIX, usual_units

FOLDER = ROOT / "out" / "boot-fleet"
ARCHITECTURES = {one.name: one for one in (AMD64, ARM64)}
STORES = Path(__file__).with_name("boot_stores.py")
PACKAGES = ("ca-certificates", "curl", "dbus", "iproute2", "procps", "sudo")  # of a usual Debian, and curl
MEMORY = "2G"
NAME, RIG = "fleet.example.org", "tent-7"
PLACE = "/srv"  # where a person stands in the machine, and the tests' own files are
SOURCE = f"{PLACE}/greenhouse"
ENGINES = [
    name.removeprefix(f"{PREFIX}-").removesuffix(".service") for name in usual_units() if "-fleet-" in name
]
LISTENING = {  # as docs/fleet.md says, address and port by service
    "broker": ["0.0.0.0:8883", "[::]:8883"],
    "web": ["*:443"],
    "numbers": ["127.0.0.1:8430"],
    "alerts": ["127.0.0.1:8431"],
    "page": ["127.0.0.1:8432"],
}
DEBIANS = "mosquitto victoria-metrics caddy"  # services that come with the engines
PASSWORD = "a long one for a try"
BOARD = """[Service]
User=greenhouse
RuntimeDirectory=board
ExecStart=/opt/greenhouse/venv/bin/python -m firmware_protocol.virtual_board \\
    --link /run/board/port --control /run/board/control --real-time
Restart=always
[Install]
WantedBy=multi-user.target
"""
SETTINGS = {
    "board": {"port": "/run/board/port"},
    "control": {"step_s": 1.0, "controller": "rules"},
    "reference": {"kind": "constant", "reference_c": 36.0},
}
STEADY_S = 60.0
INSTALL_MAX_S, UP_MAX_S, STORED_MAX_S = 3600.0, 300.0, 300.0


class BootedFleet:
    """The machine with fleet and rig, and questions to both."""

    def __init__(self, machine: Machine | Container) -> None:
        self.machine = machine
        self.sh = machine.sh

    def greenhouse(self, words: str) -> str:
        """Run `greenhouse fleet` as a person with sudo. Errors: ShellError"""
        return self.sh(f"cd {PLACE} && sudo greenhouse fleet {words}", UP_MAX_S)

    def unit(self, engine: str, key: str) -> str:
        """Return a property of an engine's unit."""
        return self.sh(f"systemctl show --value -p {key} {PREFIX}-{engine}.service")

    def memory(self, engine: str) -> str:
        """Return the memory of an engine: systemd's count, or its process's share where systemd has none."""
        counted = self.unit(engine, "MemoryCurrent")
        if counted.isdigit():
            return f"{int(counted) / 1e6:4.0f} MB by MemoryCurrent"
        share = self.sh(f"sed -n 's/^Pss: *//p' /proc/{self.unit(engine, 'MainPID')}/smaps_rollup")
        return f"{int(share.split()[0]) * 1024 / 1e6:4.0f} MB (Pss)"

    def states(self) -> dict[str, str]:
        """Return of each engine whether it runs, and how often systemd has started it anew."""
        return {name: f"{self.unit(name, 'ActiveState')} {self.unit(name, 'NRestarts')}" for name in ENGINES}

    def is_up(self) -> bool:
        """Return whether every engine runs and listens where it should."""
        active = all(state.startswith("active") for state in self.states().values())
        return active and LISTENING.items() <= self.listening().items()

    def listening(self, kind: str = "t") -> dict[str, list[str]]:
        """Return the addresses at which each service listens. kind : `t` of TCP, `u` of UDP"""
        found: dict[str, list[str]] = {}
        for line in self.sh(f"ss -Hlnp{kind}").splitlines():
            words, process = line.split(), re.search(r"pid=(\d+)", line)
            control = self.sh(f"cat /proc/{process[1]}/cgroup || true") if process else "?"
            service = control.rpartition("/")[2].removeprefix(f"{PREFIX}-").removesuffix(".service")
            found.setdefault(service, []).append(words[3])
        return {service: sorted(places) for service, places in sorted(found.items())}

    def stores(self) -> dict:
        """Return the ticks of the rig in its history, VictoriaMetrics and SQL, see boot_stores.py."""
        return json.loads(self.sh(f"python3 {PLACE}/{STORES.name} {RIG}"))

    def api(self, path: str, values: Mapping[str, str] | None = None) -> dict:
        """Ask the page as a browser elsewhere would."""
        change = ""
        if values is not None:
            change = f"-H 'content-type: application/json' -H origin:https://{NAME} -d "
            change += shlex.quote(json.dumps(values))
        url = f"https://{NAME}{path}"
        jar = f"-c {PLACE}/jar -b {PLACE}/jar --cacert /etc/greenhouse-fleet/ca.crt"
        return json.loads(self.sh(f"curl -sS --fail-with-body {jar} {change} {shlex.quote(url)}"))


def what_is_wrong(stores: dict, until: int) -> str:
    """Say where the stores lack or double a tick of the rig's history up to `until`, "" if nowhere."""
    own = {seq: stamp for seq, stamp in stores["own"] if seq <= until}
    kept = [(seq, stamp) for seq, stamp in stores["numbers"] if seq in own]
    if len(kept) != len(dict(kept)):
        return f"{len(kept) - len(dict(kept))} ticks are stored twice"
    missing = own.keys() - dict(kept).keys()
    if missing:
        return f"{len(missing)} of {len(own)} ticks are not in VictoriaMetrics: {sorted(missing)[:5]} ..."
    if dict(kept) != own:
        return "a tick has another time"
    if left := [seq for seq in own if not any(first <= seq <= last for first, last in stores["spans"])]:
        return f"{len(left)} ticks are in no span of SQL: {left[:5]} ..."
    return ""


def wait_until_stored(fleet: BootedFleet, more: int = 5) -> str:
    """Wait until the rig's ticks, and so many more, are in store once. Errors: TimeoutError"""
    until = max((seq for seq, _ in fleet.stores()["own"]), default=0) + more
    wrong = ["the rig does not tick"]

    def is_stored() -> bool:
        try:
            stores = fleet.stores()
        except ShellError as error:  # an engine that is just starting
            wrong[0] = str(error)[-300:]
            return False
        newest = max((seq for seq, _ in stores["own"]), default=0)
        wrong[0] = what_is_wrong(stores, until) if newest >= until else f"the rig is at {newest}, not {until}"
        return not wrong[0]

    try:
        took_s = wait_for(is_stored, STORED_MAX_S, "each tick is in store once")
    except TimeoutError:
        raise TimeoutError(wrong[0]) from None
    return f"{len(fleet.stores()['own'])} ticks, after {took_s:.0f} s"


def install(fleet: BootedFleet, report: BootReport) -> None:
    """The first of the two commands, twice."""
    sh = fleet.sh
    words = ("uname -srm", "echo Debian $(cat /etc/debian_version)", "systemctl --version | head -n 1")
    report.say(f"     {', '.join(map(sh, words))}")
    sh(f"mkdir {SOURCE} && tar -C {SOURCE} -xf {PLACE}/greenhouse.tar")
    for text in ("deploy/install-fleet.sh on a fresh machine", "and again"):
        began = time.monotonic()
        said = sh(f"cd {SOURCE} && sudo sh deploy/install-fleet.sh", INSTALL_MAX_S).splitlines()[-1]
        report.check(text, said.startswith("installed"), f"{time.monotonic() - began:.0f} s")
    states = [sh(f"systemctl is-{what} {DEBIANS} || true").split() for what in ("active", "enabled")]
    off = states == [["inactive"] * 3, ["disabled"] * 3]
    report.check("Debian's own services of the engines are off", off, states)


def up(fleet: BootedFleet, report: BootReport) -> None:
    """The second command."""
    fleet.greenhouse(f"up --name {NAME}")
    took_s = wait_for(fleet.is_up, UP_MAX_S, "every engine listens")
    report.check("greenhouse fleet up", True, f"every engine listens after {took_s:.0f} s")
    fleet.machine.sh(f"sleep {STEADY_S:g}")
    states = fleet.states()
    report.check(
        f"{STEADY_S:g} s later every unit is active, none was restarted",
        set(states.values()) == {"active 0"},
        states,
    )
    own = {name: places for name, places in fleet.listening().items() if name in ENGINES}
    report.check("engines listen where docs/fleet.md says", own == LISTENING, own)
    datagrams = {name: places for name, places in fleet.listening("u").items() if name in ENGINES}
    report.check("and to no datagrams", not datagrams, datagrams)
    for name in ENGINES:
        exposure = fleet.sh(f"systemd-analyze security --no-pager {PREFIX}-{name}.service | tail -n 1")
        score = re.search(r": ([0-9.]+)", exposure)
        report.say(f"     {name:<9} {fleet.memory(name)}, exposure {score[1] if score else '?'}")


def rig(fleet: BootedFleet, report: BootReport) -> None:
    """A rig comes in by its archive's README, and people look at it."""
    sh = fleet.sh
    sh(f"echo 127.0.0.1 {NAME} >>/etc/hosts")
    sh(f"cd {SOURCE} && sudo sh deploy/install.sh", INSTALL_MAX_S)
    report.check(
        "a rig's daemon is installed on the same machine, the fleet stays", fleet.greenhouse("rig list") == ""
    )
    sh(f"printf %s {shlex.quote(BOARD)} >/etc/systemd/system/board.service && systemctl enable --now board")
    said = fleet.greenhouse(f"rig add {RIG} --group north --kind tent")
    report.check("rig add", said.startswith(f"{RIG}.tar.gz") and RIG in fleet.greenhouse("rig list"))
    paper = sh(f"tar -xzOf {PLACE}/{RIG}.tar.gz README.txt")
    commands = re.findall(r"^    (.+)$", paper, re.MULTILINE)
    for command in commands[:-1]:
        sh(f"cd {PLACE} && {command}")
    mqtt = yaml.safe_load(sh("cat /etc/greenhouse/fleet/mqtt.yaml"))
    sh(f"echo {shlex.quote(yaml.safe_dump(SETTINGS | mqtt))} >/etc/greenhouse/edge.yaml")
    sh(f"greenhouse check-config /etc/greenhouse/edge.yaml && {commands[-1]}", UP_MAX_S)
    report.check("the commands of the archive's README", len(commands) > 2, wait_until_stored(fleet))
    user = sh("ps -o user= -p $(systemctl show --value -p MainPID greenhouse)")
    report.check("the rig's daemon is another user", user == "greenhouse", user)
    sh(f"cd {PLACE} && echo {shlex.quote(PASSWORD)} | sudo greenhouse fleet user add Ann --role admin")
    report.check("user add", fleet.greenhouse("user list").split() == ["Ann", "*", "admin"])
    report.check("a session", fleet.api("/api/session", {"name": "Ann", "password": PASSWORD})["ok"])
    listed = fleet.api("/api/rigs")
    row = listed["rigs"][0]
    report.check(
        "the page's API lists it",
        row["name"] == RIG and listed["broker"],
        f"{row['standing']}, {row['temp_air_c']:.1f} °C",
    )
    report.check(
        "fleet rigs", "online" in fleet.greenhouse("rigs"), " ".join(fleet.greenhouse("rigs").split())
    )
    order = fleet.api(f"/api/rigs/{RIG}/order", {"what": "temperature", "payload": "25.5"})
    report.check("an order from the page", order["ok"], order)
    wait_for(
        lambda: fleet.api("/api/rigs")["rigs"][0]["reference_c"] == 25.5, UP_MAX_S, "the rig's reference"
    )


def kills(fleet: BootedFleet, report: BootReport) -> None:
    """Each engine once."""
    for name in ENGINES:
        before = fleet.unit(name, "MainPID"), int(fleet.unit(name, "NRestarts"))
        fleet.sh(f"kill -9 {before[0]}")
        took_s = wait_for(
            lambda before=before, name=name: int(fleet.unit(name, "NRestarts")) > before[1], UP_MAX_S, name
        )
        took_s += wait_for(fleet.is_up, UP_MAX_S, f"{name} is up")
        report.check(
            f"{name} killed: up again after {took_s:.0f} s, each tick once", True, wait_until_stored(fleet)
        )


def cut_power(fleet: BootedFleet, report: BootReport) -> None:
    """Once, at whatever moment; what a person had seen in the stores must be there again."""
    seen = fleet.stores()["numbers"]
    fleet.machine.cut()
    boot_s = fleet.machine.start()
    took_s = wait_for(fleet.is_up, UP_MAX_S, "up by itself")
    text = f"{fleet.machine.CUT}: after a boot all is up by itself"
    report.check(text, True, f"boots in {boot_s:.0f} s, {took_s:.0f} s more")
    stored = wait_until_stored(fleet)
    lost = {tuple(each) for each in seen} - {tuple(each) for each in fleet.stores()["numbers"]}
    report.check("ticks of before are there, each once", not lost, stored)
    report.check("the page's session holds", fleet.api("/api/rigs")["rigs"][0]["name"] == RIG)


def down(fleet: BootedFleet, report: BootReport) -> None:
    """Up on what runs, down, up on old data, and the end of it all."""
    fleet.greenhouse("up")
    wait_for(fleet.is_up, UP_MAX_S, "up")
    report.check("up while it runs: nothing lost", True, wait_until_stored(fleet))
    before = fleet.stores()
    fleet.greenhouse("down")
    report.check("down: no unit, process or port is left", not left_running(fleet), left_running(fleet))
    data = fleet.sh("cd /var/lib/greenhouse-fleet && ls")
    report.check("its data is there", "fleet.db" in data and "numbers" in data)
    fleet.greenhouse("up")
    wait_for(fleet.is_up, UP_MAX_S, "up")
    stored = wait_until_stored(fleet)
    lost = {tuple(each) for each in before["numbers"]} - {tuple(each) for each in fleet.stores()["numbers"]}
    report.check("up again on the old data, and what the rig kept meanwhile", not lost, stored)
    fleet.greenhouse("down --erase")
    report.check(
        "down --erase: no unit, process or port is left", not left_running(fleet), left_running(fleet)
    )
    left = fleet.sh(
        r"find / -xdev -path /opt -prune -o -path /srv -prune -o -name '*greenhouse-fleet*' -print"
    )
    report.check("and no file", not left, left.replace("\n", " "))
    user = fleet.sh("getent passwd greenhouse-fleet; getent group greenhouse-fleet; true")
    report.check("and no user", not user, user)
    active = fleet.sh("systemctl is-active greenhouse")
    report.check(
        "the rig goes on", active == "active", fleet.sh("systemctl show --value -p StatusText greenhouse")
    )


def left_running(fleet: BootedFleet) -> str:
    """Return units, processes and ports of the fleet."""
    units = fleet.sh(f"systemctl list-units --all --plain --no-legend '{PREFIX}*'")
    units += fleet.sh(f"find /etc/systemd/system -name '{PREFIX}*'")
    processes = (
        fleet.sh("ps -u greenhouse-fleet -o pid=,args= || true")
        if fleet.sh("getent passwd greenhouse-fleet || true")
        else ""
    )
    ports = [place for places in LISTENING.values() for place in places]
    listening = [line for line in fleet.sh("ss -Hlnt").splitlines() if line.split()[3] in ports]
    return " ".join((units, processes, *listening)).strip()


def files(folder: Path) -> list[Path]:
    """Return what is brought to the machine: the checkout as git has it, and the questions to its stores."""
    folder.mkdir(parents=True, exist_ok=True)
    run("git", "-C", ROOT, "archive", "-o", folder / "greenhouse.tar", "HEAD")
    return [folder / "greenhouse.tar", STORES]


def emulated(architecture: MachineArchitecture, kvm: bool) -> Machine:
    """Return a machine of its own, with its power off."""
    folder = FOLDER / architecture.name
    give_network(make_tree(folder, files(folder), architecture, PACKAGES))
    make_disk(folder)
    if kvm:
        architecture = replace(architecture, qemu=(*architecture.qemu, *KVM))
    return Machine(folder, architecture=architecture, network=NETWORK, memory=MEMORY)


def container(architecture: MachineArchitecture) -> Container:
    """Return a container, in a tree of its own."""
    folder = FOLDER / architecture.name
    tree, root = make_tree(folder, files(folder), architecture, PACKAGES), folder / "container" / "root"
    shutil.rmtree(root.parent, ignore_errors=True)
    root.parent.mkdir()
    run("cp", "-a", tree, root)
    give_packages(root)
    run("chroot", root, "systemctl", "disable", "--quiet", "agent.service", "systemd-networkd.service")
    (root / "etc/fstab").unlink()
    return Container(root, f"fleet-{os.getpid()}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--architecture", choices=ARCHITECTURES, default="amd64", help="usual: %(default)s")
    parser.add_argument("--kvm", action="store_true", help="on this machine's processor; usual: emulated")
    parser.add_argument(
        "--container", action="store_true", help="systemd-nspawn: quick, on this machine's kernel"
    )
    options = parser.parse_args()
    architecture = ARCHITECTURES[options.architecture]
    report = BootReport()
    report.say(" ".join(("python tests/deploy/boot_fleet.py", *sys.argv[1:])))
    for line in header():
        report.say(line)
    machine = container(architecture) if options.container else emulated(architecture, options.kvm)
    what = f"{architecture.name} in qemu"
    if options.container:
        what = "a container under systemd-nspawn, with this machine's kernel and network"
    report.say(f"     {what}, boots in {machine.start():.0f} s")
    fleet = BootedFleet(machine)
    try:
        for step in (install, up, rig, kills, cut_power, down):
            step(fleet, report)
    finally:
        machine.cut()
    report.say("every test has passed")
    (RESULTS / "boot_fleet.txt").write_text("\n".join(report.lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
