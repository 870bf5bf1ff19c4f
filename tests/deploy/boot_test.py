"""Tries the Debian package on a booted arm64 machine, with the Mega's program at its USB serial adapter.

    python tests/deploy/boot_test.py DEB [--cuts 20] [--minutes 60]

Everything is emulated, the machine by qemu, the microcontroller by simavr, so its times say nothing of a
single-board computer. Run it as root, from the checkout. It keeps its output in bench/results/boot.txt.
"""

import argparse
import hashlib
import json
import os
import random
import shlex
import shutil
import time
from pathlib import Path

import yaml
from boot_machine import Machine, make_disk, make_tree, run
from boot_report import BootReport, wait_for

from bench.header import RESULTS, ROOT, header
from tests.support.virtual_board import VirtualBoard, virtual_board

FOLDER = ROOT / "out" / "boot-test"
AVR = ROOT / "tests" / "firmware_protocol"
CONFIG, HISTORY = "/etc/greenhouse/edge.yaml", "/var/lib/greenhouse/history.db"
SENSORS = (  # as they hang on the simulated microcontroller
    {"part": "sht4x", "address": "0x44"},
    {"part": "ds18b20", "pin": "D30", "serial": "28-000000000001"},
    {"part": "ds18b20", "place": "outside", "pin": "D30", "serial": "28-000000000002"},
)
ANSWERS = {  # of a person to `greenhouse setup`: the paper's box
    "port": "/dev/greenhouse",
    "volume_m3": 0.15,
    "heater_w": 100.0,
    "fan_role": "exhaust",
    "fan_m3_h": 68.0,
    "wall": "",
    "step_s": 60.0,
    "min_c": 15.0,
    "max_c": 38.0,
    "reference_c": 36.0,
}
WARM = {"reference": {"reference_c": 36.0}}  # so hot that the heater is on
FAST = {**WARM, "control": {"step_s": 1.0, "controller": "rules"}}  # the packaged models are made for 60 s
# Times of an emulated machine on a busy one.
HEAT_MAX_S, RESTART_MAX_S, INSTALL_MAX_S = 180.0, 900.0, 5400.0
START_MAX_S = 900.0  # of the daemon, to systemd
DIAGNOSIS_IN_S = 240
LATE_MS = 100.0  # above, the daemon says so
SMALL = "48M"  # instead of the unit's own limit, which a diagnosis of all rows that it may read does not meet


class BootedRig:
    """The machine with the package, the board at its USB adapter, and questions to both."""

    def __init__(self, machine: Machine, board: VirtualBoard) -> None:
        self.machine, self.board = machine, board

    def unit(self, key: str) -> str:
        """Return a property of the daemon's unit."""
        return self.machine.sh(f"systemctl show --value -p {key} greenhouse.service")

    def status(self) -> dict:
        """Return `greenhouse status --json`."""
        return json.loads(self.machine.sh("greenhouse status --json"))

    def rows(self, sql: str) -> list:
        """Return the rows of a query of the history."""
        code = (
            f"import json, sqlite3; c = sqlite3.connect('file:{HISTORY}?mode=ro', uri=True); "
            f"print(json.dumps(c.execute({sql!r}).fetchall()))"
        )
        return json.loads(self.machine.sh(f"python3 -c {shlex.quote(code)}"))

    def seq(self) -> int:
        """Return the newest tick of the history."""
        return self.rows("SELECT max(seq) FROM ticks")[0][0]

    def configure(self, settings: dict) -> None:
        """Write the settings and start the daemon anew."""
        self.machine.sh(f"echo {shlex.quote(yaml.safe_dump(settings))} >{CONFIG}")
        self.machine.sh(f"greenhouse check-config {CONFIG} && systemctl restart greenhouse", RESTART_MAX_S)

    def heater_is_on(self) -> bool:
        """Return whether the board drives its heater pin."""
        return bool(self.board.truth()["pins"]["heater_relay"])


def another_version(deb: Path, version: str) -> Path:
    """Return the package with another number."""
    tree, other = FOLDER / "tree", FOLDER / f"{version}.deb"
    shutil.rmtree(tree, ignore_errors=True)
    run("dpkg-deb", "-R", deb, tree)
    core = tree / "opt/greenhouse/package/lib/python3.11/site-packages/edge/core"
    (core / "version.py").write_text(f'__version__ = "{version}"\n')
    for compiled in core.glob("__pycache__/version.*"):
        compiled.unlink()
    sums = tree / "DEBIAN/md5sums"
    names = [line.split("  ", 1)[1] for line in sums.read_text().splitlines()]
    there = [(tree / name, name) for name in names if (tree / name).exists()]
    digests = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {name}\n" for path, name in there]
    sums.write_text("".join(digests))
    control = tree / "DEBIAN/control"
    lines = control.read_text().splitlines(keepends=True)
    control.write_text(
        "".join(f"Version: {version}\n" if line.startswith("Version:") else line for line in lines)
    )
    run("dpkg-deb", "--root-owner-group", "-Znone", "-b", tree, other)
    return other


def install(rig: BootedRig, report: BootReport) -> None:
    """From a machine without the package and an unconfigured board to a heater that is on."""
    sh = rig.machine.sh
    report.say(f"     {sh('uname -srm')}, {sh('systemctl --version | head -n 1')}")
    sh("apt-get install -y --no-install-recommends /srv/1.deb", INSTALL_MAX_S)
    report.check("installs", True, sh("greenhouse --version"))
    adapter = sh(
        "readlink /sys/class/tty/ttyUSB0/device/driver | xargs basename; readlink -f /dev/greenhouse"
    )
    report.check("udev names the adapter", adapter.split() == ["ftdi_sio", "/dev/ttyUSB0"], adapter.split())
    report.check("nothing heats before a person starts it", rig.unit("ActiveState") == "inactive")
    sh("greenhouse board configure /srv/board.yaml")
    report.check("an empty board is configured", "Air temperature" in sh("greenhouse board show"))
    sh(f"greenhouse setup --from-answers /srv/answers.json --replace && greenhouse check-config {CONFIG}")
    sh("systemctl start greenhouse", RESTART_MAX_S)
    report.check("setup's settings start it", rig.unit("ActiveState") == "active", rig.unit("StatusText"))
    rig.configure(FAST)
    wait_for(rig.heater_is_on, HEAT_MAX_S, "the heater is on")
    tick, truth = rig.status()["tick"], rig.board.truth()["chamber"]["temp_air_c"]
    air = tick["readings"]["temp_air_c"]["value"]
    report.check("heats over the adapter, and reads the air", abs(air - truth) < 1.0, f"{air:.1f} °C")


def watchdog(rig: BootedRig, report: BootReport) -> None:
    """A daemon that hangs."""
    before = rig.seq()
    rig.machine.sh(f"kill -STOP {rig.unit('MainPID')}")
    took_s = wait_for(lambda: not rig.heater_is_on(), HEAT_MAX_S, "the heater is off")
    report.check("the heater of a daemon that hangs goes off", True, f"after {took_s:.0f} s")
    took_s += wait_for(lambda: int(rig.unit("NRestarts")) > 0, RESTART_MAX_S, "the watchdog ends it")
    wait_for(lambda: rig.unit("ActiveState") == "active" and rig.seq() > before, RESTART_MAX_S, "it ticks")
    wait_for(rig.heater_is_on, HEAT_MAX_S, "the heater is on again")
    said = rig.machine.sh("journalctl -u greenhouse | grep -c 'Watchdog timeout'")
    report.check("the watchdog restarts it, and it heats again", said == "1", f"killed after {took_s:.0f} s")


def memory_limit(rig: BootedRig, report: BootReport) -> None:
    """A nightly diagnosis that needs more than its unit may have, at 60 s steps: the packaged twin's."""
    sh = rig.machine.sh
    report.check("the kernel can limit memory", "memory" in sh("cat /sys/fs/cgroup/cgroup.controllers"))
    sh(f"systemctl set-property --runtime greenhouse-diagnosis.service MemoryMax={SMALL}")
    at = sh(f"date -d '{DIAGNOSIS_IN_S} seconds' +%H:%M")
    rig.configure({**WARM, "drift": {"diagnose": "always", "diagnose_at": at}})
    restarts = rig.unit("NRestarts")
    failed = "SELECT text FROM events WHERE key = 'diagnosis.failed'"
    wait_for(lambda: rig.rows(failed), DIAGNOSIS_IN_S + RESTART_MAX_S, "the diagnosis fails")
    report.check(f"a diagnosis is ended at {SMALL}, and it is told", "memory" in rig.rows(failed)[0][0])
    killed = sh("journalctl -k | grep -c 'oom-kill.*greenhouse-diagnosis.service'")
    report.check("the kernel ended it, in its own unit", int(killed) >= 1)
    before = rig.seq()
    wait_for(lambda: rig.seq() >= before + 2, RESTART_MAX_S, "two more ticks")
    report.check(
        "control goes on in the same process", rig.unit("NRestarts") == restarts, rig.unit("StatusText")
    )
    report.check("and heats", rig.rows("SELECT sent_heater_duty FROM v_ticks ORDER BY seq DESC")[0][0] > 0.0)
    rig.configure(FAST)


def cut_power(rig: BootedRig, report: BootReport, cuts: int, random_: random.Random) -> None:
    """Cut while the disk writes its cache down; each time all that a reader had seen must be there again."""
    boots = []
    for number in range(1, cuts + 1):
        before = rig.seq()
        wait_for(lambda before=before: rig.seq() >= before + 3, RESTART_MAX_S, "it ticks")
        time.sleep(random_.uniform(0.0, 5.0))
        seen = rig.seq()
        rig.machine.wait_for_flush()
        time.sleep(random_.choice((0.0, random_.uniform(0.0, 0.02), random_.uniform(0.0, 1.0))))
        rig.machine.cut()
        boots.append(rig.machine.start())
        wait_for(lambda: rig.unit("ActiveState") == "active", RESTART_MAX_S, "the daemon starts at boot")
        wait_for(lambda seen=seen: rig.seq() > seen, RESTART_MAX_S, "it ticks again")
        rows = rig.rows(f"SELECT count(*), max(seq) FROM ticks WHERE seq <= {seen}")[0]
        intact = rig.rows("PRAGMA integrity_check") == [["ok"]]
        lost = seen - rig.rows("SELECT min(seq) FROM ticks")[0][0] + 1 - rows[0] - _in_gaps(rig, seen)
        aside = rig.machine.sh("find /var/lib/greenhouse -name '*.aside-*'")
        stopped = rig.status()["operation"]["emergency_stop"]
        ok = intact and rows[1] == seen and lost == 0 and not aside and not stopped
        if not ok or number == cuts:
            facts = f"integrity {intact}, {lost} ticks lost of {rows[0]}, set aside: {aside or 'nothing'}"
            report.check(f"{number} power cuts while the disk is written", ok, facts)
    report.say(f"     {len(boots)} boots, {min(boots):.0f} to {max(boots):.0f} s")


def _in_gaps(rig: BootedRig, until: int) -> int:
    """Return how many numbers up to `until` the history says were never given to a tick."""
    span = f"min(last_seq, {until}) - first_seq + 1"
    return rig.rows(f"SELECT coalesce(sum({span}), 0) FROM gaps WHERE first_seq <= {until}")[0][0]


def upgrade(rig: BootedRig, report: BootReport) -> None:
    """While the daemon heats."""
    before = rig.unit("MainPID"), rig.seq()
    rig.machine.sh("apt-get install -y --no-install-recommends /srv/0.2.0.deb", INSTALL_MAX_S)
    version = rig.machine.sh("greenhouse --version")
    report.check("upgrades while it runs", version.endswith("0.2.0"), version)
    wait_for(lambda: rig.seq() > before[1], RESTART_MAX_S, "it ticks")
    report.check("the new version runs, from its own folder", rig.unit("MainPID") != before[0])
    wait_for(rig.heater_is_on, HEAT_MAX_S, "the heater is on")
    differing = rig.machine.sh("dpkg --verify greenhouse | grep -v ' c /etc/' || true")
    report.check("the files are the package's", not differing, differing)


def real_time(rig: BootedRig, report: BootReport, minutes: float) -> None:
    """So long at 1 s steps; ticks that were late or left out are counted."""
    rig.configure(FAST)
    first, restarts = rig.seq() + 5, rig.unit("NRestarts")
    time.sleep(60.0 * minutes)
    last = rig.seq()
    late = [row[0] for row in rig.rows(f"SELECT late_s FROM ticks WHERE seq BETWEEN {first} AND {last}")]
    skipped, unlinked = rig.rows(
        f"SELECT sum(ticks_skipped), sum(NOT link_up) FROM ticks WHERE seq BETWEEN {first} AND {last}"
    )[0]
    late_ms = sorted(1e3 * late_s for late_s in late)
    report.say(f"     {minutes:g} min at 1 s steps: {len(late_ms)} ticks, {skipped} left out")
    report.say(f"     {unlinked} ticks without the board")
    median, most = late_ms[len(late_ms) // 2], late_ms[-1]
    share = sum(late > LATE_MS for late in late_ms) / len(late_ms)
    report.say(f"     late: median {median:.0f} ms, most {most:.0f} ms, {share:.1%} above {LATE_MS:g} ms")
    report.check("nothing was restarted", rig.unit("NRestarts") == restarts)


def be_patient(root: Path) -> None:
    """Give the daemon's unit more time to start than a real processor needs."""
    slow = root / "etc/systemd/system/greenhouse.service.d"
    slow.mkdir(exist_ok=True)
    (slow / "emulated.conf").write_text(f"[Service]\nTimeoutStartSec={START_MAX_S:g}\n")


def documents() -> list[Path]:
    """Return what a person writes for a new rig: board.yaml and the answers to setup."""
    board = yaml.safe_load((ROOT / "deploy" / "board.example.yaml").read_text())
    board_file, answers = FOLDER / "board.yaml", FOLDER / "answers.json"
    board_file.write_text(yaml.safe_dump({**board, "sensors": list(SENSORS)}))
    answers.write_text(json.dumps(ANSWERS))
    return [board_file, answers]


def avr_host() -> Path:
    """Return the program that runs a board's program in simavr."""
    target = FOLDER / "avr_host"
    run("gcc", "-std=gnu11", "-O2", AVR / "avr" / "avr_host.c", "-lsimavr", "-lelf", "-o", target)
    return target


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("deb", type=Path)
    parser.add_argument("--cuts", type=int, default=20, help="power cuts; default: %(default)s")
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="in real time at 1 s steps; default: %(default)s"
    )
    options = parser.parse_args()
    report = BootReport()
    for line in header():
        report.say(line)
    FOLDER.mkdir(parents=True, exist_ok=True)
    shutil.copy(options.deb, FOLDER / "1.deb")
    files = [FOLDER / "1.deb", another_version(options.deb, "0.2.0"), *documents()]
    be_patient(make_tree(FOLDER, files))
    make_disk(FOLDER)
    os.environ |= {"AVR_HOST": str(avr_host()), "PYTHONPATH": os.pathsep.join((str(ROOT), str(AVR)))}
    os.environ["AVR_BLANK"] = "1"
    core = ("--core", "avr.avr_core:mega2560", "--with", "heater_cutoff")
    with virtual_board(FOLDER, "--real-time", *core) as board:
        machine = Machine(FOLDER, board.port)
        report.say(f"     boots in {machine.start():.0f} s")
        rig = BootedRig(machine, board)
        install(rig, report)
        watchdog(rig, report)
        memory_limit(rig, report)
        cut_power(rig, report, options.cuts, random.Random(options.cuts))
        upgrade(rig, report)
        real_time(rig, report, options.minutes)
        machine.cut()
    report.say("every test has passed")
    (RESULTS / "boot.txt").write_text("\n".join(report.lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
