"""python -m bench.kills: kill -9 the whole daemon after an acknowledged stop; does any actuator move again?

A seed draws each kill: emergency stop or maintenance, control socket or MQTT, link up or unplugged, disk
fast or slow, when the kill comes, how long the board is alone, whether it resets, whether a second kill hits
the start. Then the daemon starts anew, and the board's pins (heater, fan, LED, valve) must rest until the
release. The board runs in lock-step, 40 s in one second, and turns its fan on when it is alone: the hardest
case. After the release the actuators must move, or the check could not fail.
"""

import argparse
import ctypes
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import yaml

from bench.attack.part import TrialResult
from edge.config import loading as config
from edge.core.errors import RequestError
from edge.core.hard_limits import LEASE_S
from edge.core.processes import die_with_parent
from edge.formats.atomic_file import write_document
from edge.sockets.client import request
from tests.support.broker import MOSQUITTO, Broker, Listener, wait_for
from tests.support.virtual_board import CORES, VirtualBoard, virtual_board
from training.lab import Lab

RIG = "greenhouse/rig-1"
SPEED = 40.0  # simulated seconds in one of ours
STEP_S = 5.0
MOVING = {
    "do": "set_manual",
    "heater_duty": 0.4,
    "fan_on": 1,
    "led": 0.5,
}  # before the stop, and after its release
REACHED_S = 6.0  # a link that is back: reopening the port, the greeting and the stop take so long at most
WATCHED_S = 30.0  # simulated time between the restart and the last look: three leases
# The fan's switches of an hour outlive a kill, and each restart counts two. 80 kills take a simulated hour.
FAN_FREE = {"fan_min_on_s": 0.0, "fan_min_off_s": 0.0, "fan_switches_hour_max": 720}
SHARES = {"unplugged": 0.25, "slow disk": 0.3, "reset": 0.2, "killed twice": 0.3}
PINS = ("heater_relay", "fan", "led", "valve")


@dataclass(frozen=True, slots=True)
class KillPlan:
    """One kill, as its seed has drawn it. Times in s, `_real` in our time, else simulated."""

    order: str  # "emergency_stop" or "maintenance"
    door: str  # "socket" or "mqtt"
    unplugged_s: float  # 0: the link is up
    fsync_real_s: float  # 0: as the disk is
    kill_after_real_s: float  # from the answer
    alone_s: float
    reset: bool  # while the board is alone
    again_after_real_s: float | None  # a second kill, during the start


def plan(random_: random.Random, doors: Sequence[str]) -> KillPlan:
    """Draw one kill."""

    def chance(of: str) -> bool:
        return random_.random() < SHARES[of]

    return KillPlan(
        order=random_.choice(("emergency_stop", "maintenance")),
        door=random_.choice(doors),
        unplugged_s=random_.uniform(5.0, 40.0) if chance("unplugged") else 0.0,
        fsync_real_s=random_.uniform(0.05, 0.3) if chance("slow disk") else 0.0,
        kill_after_real_s=random_.choice((0.0, random_.uniform(0.0, 0.01), random_.uniform(0.0, 0.5))),
        alone_s=random_.uniform(0.0, 30.0),
        reset=chance("reset"),
        again_after_real_s=random_.uniform(0.0, 0.8) if chance("killed twice") else None,
    )


class Nursery:
    """A process that has imported the daemon and forks one for each start, without a second of imports."""

    def __init__(self, config_file: Path, control: Path, log: Path) -> None:
        command = [sys.executable, "-m", "bench.kills", "--nursery", str(config_file), str(control)]
        self._log = log.open("ab")
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True,
            preexec_fn=die_with_parent,
        )  # fmt: skip

    def start(self, fsync_real_s: float) -> int:
        """Start a daemon whose state file takes so much longer; its process id."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{fsync_real_s}\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self) -> None:
        """End it; its daemons die with it."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._log):
            if pipe is not None:
                pipe.close()


def nursery(config_file: Path, control: Path) -> None:
    """Fork a daemon for each line of standard input; end with the input."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the killed ones leave no zombies
    for line in sys.stdin:
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            os.dup2(2, 1)
            _live(config_file, control, float(line))
            os._exit(0)
        print(pid, flush=True)


def _live(config_file: Path, control: Path, fsync_real_s: float) -> None:
    """One daemon, from start to its death."""
    # The limit of releases outlives a kill too, and 80 an hour exceed what it allows at length.
    patch("edge.tick.loop.RELEASE_EVERY_S", 0.0).start()
    if fsync_real_s > 0.0:

        def slowly(path: Path, values: dict[str, Any]) -> None:
            time.sleep(fsync_real_s)
            write_document(path, values)
            time.sleep(fsync_real_s)

        patch("edge.state.writer.write_document", slowly).start()
    with Lab(
        config.load(config_file),
        board=control,
        folder=config_file.parent,
        speed=SPEED,
        config_file=config_file,
    ) as lab:
        lab.run()


class KilledRig:
    """A virtual board and the daemon that is killed."""

    def __init__(self, folder: Path, board: VirtualBoard, listener: Listener | None, port: int) -> None:
        self.folder, self.board, self.listener = folder, board, listener
        self.socket = folder / "daemon.sock"
        config_file = folder / "edge.yaml"
        config_file.write_text(yaml.safe_dump(_configuration(folder, port)))
        self.nursery = Nursery(config_file, board.control, folder / "daemon.log")
        self.pid = 0

    @property
    def doors(self) -> tuple[str, ...]:
        """Ways to give an order."""
        return ("socket", "mqtt") if self.listener else ("socket",)

    def start(self, fsync_real_s: float = 0.0) -> None:
        """Start a daemon, and wait for nothing."""
        self.pid = self.nursery.start(fsync_real_s)

    def kill(self) -> None:
        """kill -9, and wait until it has gone."""
        os.kill(self.pid, signal.SIGKILL)
        wait_for(lambda: not Path(f"/proc/{self.pid}").exists(), "the daemon is dead")

    def restart(self, fsync_real_s: float = 0.0) -> None:
        """Start a daemon, and wait for its first tick."""
        self.start(fsync_real_s)
        wait_for(lambda: self.status().get("tick") is not None, f"a tick, see {self.folder}/daemon.log", 60.0)

    def status(self) -> dict[str, Any]:
        """{} while no daemon answers."""
        try:
            return request(self.socket, {"do": "status"})
        except RequestError:
            return {}

    def order(self, door: str, order: Mapping[str, Any]) -> dict[str, Any]:
        """Give an order by one of the doors; its answer."""
        if door == "socket" or self.listener is None:
            return request(self.socket, order)
        what = str(order["do"])
        payload = str(order["minutes"]) if what == "maintenance" else "PRESS"
        listener = self.listener
        heard = len(listener.objects(f"{RIG}/reply"))

        def replies() -> list[dict[str, Any]]:
            return [r for r in listener.objects(f"{RIG}/reply")[heard:] if r["command"] == what]

        online = [b"online"]
        wait_for(lambda: listener.payloads(f"{RIG}/availability")[-1:] == online, "online", 60.0)
        listener.send(f"{RIG}/set/{what}", payload)
        wait_for(replies, f"a reply to {what}", 60.0)
        return replies()[0]

    def close(self) -> None:
        """End all that was started here."""
        self.nursery.close()


def _configuration(folder: Path, port: int) -> dict[str, Any]:
    return {
        "state_file": str(folder / "state.json"),
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
        "board": {"port": str(folder / "port")},
        "control_socket": {"path": str(folder / "daemon.sock")},
        "history": {"path": str(folder / "history.db")},
        "mqtt": {
            "enabled": bool(port),
            "host": "127.0.0.1",
            "port": port or 1883,
            "rig": "rig-1",
        },
        "control": {"step_s": STEP_S, "controller": "rules"},
        "drift": {"enabled": False},
        "box": {"heater_w": 100.0},
        "safety": {"heater_rise_per_s": 1.0, **FAN_FREE},
    }


@contextmanager
def rig_in(folder: Path, core: str) -> Iterator[KilledRig]:
    """Yield a running board and a broker where mosquitto is installed; no daemon yet."""
    with ExitStack() as stack:
        options = ("--core", CORES[core], "--fan-safe-on", "--with", "heater_cutoff")
        board = stack.enter_context(virtual_board(folder, *options))
        listener, port = None, 0
        if MOSQUITTO is not None:
            broker = stack.enter_context(Broker(folder))
            port = broker.port
            listener = stack.enter_context(Listener(port, f"{RIG}/+"))
        rig = KilledRig(folder, board, listener, port)
        stack.callback(rig.close)
        yield rig


def one_kill(rig: KilledRig, drawn: KillPlan) -> list[str]:
    """Carry out one kill with a daemon whose actuators move; the violations."""
    still_from = _stop(rig, drawn)
    if isinstance(still_from, str):
        return [still_from]
    time.sleep(drawn.kill_after_real_s)
    rig.kill()
    if drawn.reset:
        rig.board.inject(name="reset", cause="watchdog")
    _advance(rig, drawn.alone_s)
    if drawn.again_after_real_s is not None:
        rig.start(drawn.fsync_real_s)
        time.sleep(drawn.again_after_real_s)
        rig.kill()
    if drawn.unplugged_s:  # the fan is the board's own until the link is back and the stop has come
        rejoined_s = max(_now(rig), still_from["link back"])
        still_from |= {"fan": rejoined_s + REACHED_S}
    rig.restart()
    wait_for(lambda: _now(rig) >= max(map(still_from.__getitem__, PINS)) + WATCHED_S, "time passes", 120.0)
    found = _movements(rig, still_from)
    operation = rig.status()["operation"]
    if not (operation["emergency_stop"] or operation["maintenance_until_utc"]):
        found.append("the restarted daemon does not know of it")
    return found + _release(rig, drawn)


def _stop(rig: KilledRig, drawn: KillPlan) -> dict[str, float] | str:
    """Give the order; from when on each pin must be off [simulated s], or why it was not acknowledged."""
    unplugged_at_s = _now(rig)
    if drawn.unplugged_s:
        rig.board.inject(name="unplug", duration_s=drawn.unplugged_s)
        wait_for(lambda: not rig.status()["link_up"], "the link is down")
    answer = rig.order(drawn.door, _request(drawn.order))
    if not answer["ok"]:
        return f"refused: {answer['error']}"
    if not drawn.unplugged_s:
        return dict.fromkeys(PINS, _now(rig))
    lease_ends_s = unplugged_at_s + LEASE_S + STEP_S  # a lease that the last command renewed
    # On a machine with much to do the cable is back before the order is read: until then the daemon drives.
    still_from = dict.fromkeys(PINS, max(lease_ends_s, _now(rig)))
    return still_from | {"link back": unplugged_at_s + drawn.unplugged_s}


def _request(order: str) -> dict[str, Any]:
    return {"do": order, "minutes": 600} if order == "maintenance" else {"do": order}


def _release(rig: KilledRig, drawn: KillPlan) -> list[str]:
    """End the stop; now the actuators must move again."""
    before = _now(rig)
    if drawn.order == "maintenance":
        answer = rig.order(drawn.door, {"do": "maintenance", "minutes": 0})
    else:
        answer = rig.order(drawn.door, {"do": "release_emergency_stop"})
    if not answer["ok"]:
        return [f"release: {answer['error']}"]
    try:
        wait_for(lambda: not _resting(rig, before), "moves again", 60.0)
    except AssertionError:
        return [f"after the release {_resting(rig, before)} did not move"]
    return []


def _resting(rig: KilledRig, since_s: float) -> list[str]:
    last = rig.board.truth()["last_on_s"]
    return [pin for pin in PINS if pin != "valve" and not (last[pin] or 0.0) > since_s]


def _movements(rig: KilledRig, still_from: Mapping[str, float]) -> list[str]:
    last = rig.board.truth()["last_on_s"]
    late = {pin: (last[pin] or 0.0) - still_from[pin] for pin in PINS}
    return [f"{pin} on {late_s:.1f} s after it had to be off" for pin, late_s in late.items() if late_s > 0.0]


def _now(rig: KilledRig) -> float:
    return float(rig.board.truth()["time_s"])


def _advance(rig: KilledRig, duration_s: float) -> None:
    """Let time pass for a board without a host."""
    rig.board.ask(advance_to_s=_now(rig) + duration_s)


def trials(seed: int, count: int, core: str = "python") -> Iterator[tuple[KillPlan, TrialResult]]:
    """Each kill with what was wrong after it; all in one rig."""
    with tempfile.TemporaryDirectory(prefix="gh-kills-") as name, rig_in(Path(name), core) as rig:
        rig.restart()
        rig.order("socket", MOVING)
        wait_for(lambda: not _resting(rig, 0.0), "the actuators move")
        for number in range(count):
            drawn = plan(random.Random(f"{seed}/{number}"), rig.doors)
            yield drawn, TrialResult(f"{seed}/{number}: {drawn}", 1, one_kill(rig, drawn))


def attack(seed: int, count: int) -> Iterator[TrialResult]:
    """Run the kills as a part of `python -m bench.attack`."""
    for _, found in trials(seed, count):
        yield found


def run(kills: int, seed: int, core: str, say: Callable[[str], None] = print) -> int:
    """Kill so often, print the table; the number of violations."""
    counts: Counter[tuple[str, str]] = Counter()
    violations, begun_s = 0, time.monotonic()
    say(f"seed {seed}, core {core}, {kills} kills; each kill is drawn from 'seed/number'")
    for drawn, found in trials(seed, kills, core):
        violations += len(found.violations)
        for text in found.violations:
            say(f"VIOLATION {found.name}: {text}")
        for kind, value in _kinds(drawn):
            counts[kind, value] += 1
    say("| kills | of them |\n|---|---:|")
    for (kind, value), count in sorted(counts.items()):
        say(f"| {kind}: {value} | {count} |")
    say(f"| all | {kills} |\n")
    each_s = (time.monotonic() - begun_s) / kills
    say(f"{violations} violations in {kills} kills, {each_s:.1f} s each")
    return violations


def _kinds(drawn: KillPlan) -> list[tuple[str, str]]:
    return [
        ("order", drawn.order),
        ("door", drawn.door),
        ("link", "unplugged" if drawn.unplugged_s else "up"),
        ("disk", "slow" if drawn.fsync_real_s else "as it is"),
        ("board", "reset meanwhile" if drawn.reset else "ran on"),
        ("killed", "once" if drawn.again_after_real_s is None else "again at the start"),
    ]


def main(words: Sequence[str] | None = None) -> int:
    """1 when an actuator has moved."""
    parser = argparse.ArgumentParser(prog="python -m bench.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--core", choices=tuple(CORES), default="python", help="of the virtual board")
    parser.add_argument(
        "--nursery", nargs=2, type=Path, metavar=("CONFIG", "CONTROL"), help=argparse.SUPPRESS
    )
    arguments = parser.parse_args(words)
    if arguments.nursery:
        nursery(*arguments.nursery)
        return 0
    return 1 if run(arguments.kills, arguments.seed, arguments.core) else 0


if __name__ == "__main__":
    sys.exit(main())
