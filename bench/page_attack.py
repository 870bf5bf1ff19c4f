"""python -m bench.page_attack: a daemon ticks each second while strangers attack the page beside it.

Quiet and attacked minutes take turns. An attack is all of `tests.support.hostile_requests` again and again,
many at once, beside slow requests, 200 open streams of which half are never read, and connections that say
nothing. The attacker has the lowest priority: in life it is another machine. In the same minutes a bare loop
of time.sleep shows what this machine's load alone does.
"""

import argparse
import itertools
import json
import os
import random
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.daemon import bare_loop
from bench.default_daemon import ProcessMemory, memory_of
from edge.page.access import DAY_S, Role
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT, DaemonProcess
from tests.support.hostile_requests import CLOSED, HostileRequest, Victim, hostile_requests, send
from tests.support.page_process import Client, PageProcess, page_of
from tests.support.virtual_board import virtual_board

AT_ONCE = 32  # hostile requests under way
STREAMS, SESSIONS = 200, 20
SILENT = 30
NO_ROOM = (CLOSED, 503)  # also right answers to any request while all places are taken
SETTLE_TICKS = 5
LEAVE_S = 12.0  # in which the page ends what an attack has left behind


@dataclass(slots=True)
class PageAttack:
    """One attacker: threads that send until `until_s`, and what they found."""

    victim: Victim
    streams: Sequence[str]  # secrets of sessions
    until_s: float
    sent: int = 0
    refused: int = 0
    got_in: list[str] = field(default_factory=list)

    def run(self, seed: int) -> dict[str, Any]:
        """Attack, and return what was sent and what got in."""
        requests = hostile_requests(self.victim)
        fast = [request for request in requests if not request.is_slow]
        random.Random(seed).shuffle(fast)
        queue, lock = itertools.cycle(fast), threading.Lock()

        def take() -> HostileRequest:
            with lock:
                return next(queue)

        with ThreadPoolExecutor(AT_ONCE + len(requests)) as pool:
            for _ in range(AT_ONCE):
                pool.submit(self._repeat, take)
            for request in requests:
                if request.is_slow:
                    pool.submit(self._repeat, lambda request=request: request)
            pool.submit(self._hold)
        return {"sent": self.sent, "refused": self.refused, "got_in": self.got_in, "kinds": len(requests)}

    def _repeat(self, take: Any) -> None:
        while time.monotonic() < self.until_s:
            request = take()
            try:
                status, _ = send(self.victim.port, request)
            except OSError:
                status = CLOSED
            self.sent += 1
            self.refused += status in NO_ROOM
            if status not in request.answers and status not in NO_ROOM:
                self.got_in.append(f"{status} {request.kind} {request.data[:100]!r}")

    def _hold(self) -> None:
        """Keep streams and silent connections open; of every second stream nothing is read."""
        heads = [self.victim.request("GET", "/api/stream", None, secret) for secret in self.streams]
        heads = [*(heads[k % len(heads)] for k in range(STREAMS)), *(b"" for _ in range(SILENT))]
        opened: dict[socket.socket, int] = {}
        while time.monotonic() < self.until_s:
            for place in set(range(len(heads))) - set(opened.values()):
                if time.monotonic() > self.until_s:
                    break
                with suppress(OSError):
                    connection = socket.create_connection(("127.0.0.1", self.victim.port), timeout=1)
                    connection.sendall(heads[place])
                    opened[connection] = place
            readable, _, _ = select.select([each for each, place in opened.items() if place % 2], [], [], 0.2)
            for connection in readable:
                with suppress(OSError):
                    if connection.recv(65536):
                        continue
                opened.pop(connection)
                connection.close()
        for connection in opened:
            connection.close()


@dataclass(slots=True)
class Phase:
    """Some seconds: lateness and decisions of ticks, lateness of a bare loop [ms]; CPU time of the page."""

    late_ms: list[float] = field(default_factory=list)
    decide_ms: list[float] = field(default_factory=list)
    peer_ms: list[float] = field(default_factory=list)
    page_cpu_s: float = 0.0


class Watch(threading.Thread):
    """Looks every half second how much memory a process takes."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self._pid, self.highest_mb, self._ended = str(pid), 0.0, threading.Event()

    def run(self) -> None:
        """Look until `end`."""
        while not self._ended.wait(0.5):
            self.highest_mb = max(self.highest_mb, memory_of(self._pid).pss)

    def end(self) -> float:
        """Return the highest that was seen [MB]."""
        self._ended.set()
        self.join()
        return self.highest_mb


def kept_state(page: PageProcess, daemon: DaemonProcess) -> dict[str, Any]:
    """Return what an attack must not change."""
    operation = daemon.ask("status")["operation"]
    return {
        "orders that stand": {key: value for key, value in operation.items() if "utc" not in key},
        "orders in the history": daemon.rows("SELECT count(*) FROM events WHERE key LIKE 'operator%'"),
        "ticks without a gap": daemon.rows("SELECT count(*) FROM gaps"),
        "sessions": sorted(int(str(each["session"])) for each in page.access.sessions()),
        "files": sorted(path.name for path in daemon.config.parent.rglob("stop*")),
    }


def observe(phase: Phase, daemon: DaemonProcess, page_pid: int, seconds: float) -> None:
    """Let so many seconds pass, and add their ticks to a phase."""
    first, began_s = daemon.seq(), cpu_s(page_pid)
    phase.peer_ms.extend(bare_loop(seconds))
    phase.page_cpu_s += cpu_s(page_pid) - began_s
    last = daemon.seq()
    wait_for(lambda: daemon.seqs()[-1] >= last)
    rows = daemon.rows(f"SELECT late_s, decide_ms FROM ticks WHERE seq BETWEEN {first + 1} AND {last}")
    phase.late_ms.extend(1e3 * late_s for late_s, _ in rows)
    phase.decide_ms.extend(decide_ms for _, decide_ms in rows)


def cpu_s(pid: int) -> float:
    """Return the CPU time of all threads of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def attacker(victim: Victim, sessions: Sequence[str], seconds: float, seed: int) -> "subprocess.Popen[bytes]":
    """Start an attack in a process of its own, at the lowest priority."""
    words = json.dumps([victim.port, victim.admin, victim.guest, list(sessions), seconds, seed])
    command = [sys.executable, "-m", "bench.page_attack", "--attack", words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, preexec_fn=lambda: os.nice(19))


def attack(words: str) -> None:
    """Be the attacker of `attacker`, and print what was found as JSON."""
    port, admin, guest, sessions, seconds, seed = json.loads(words)
    found = PageAttack(Victim(port, admin, guest), sessions, time.monotonic() + seconds)
    print(json.dumps(found.run(seed)))


def stop_in_the_storm(client: Client) -> float:
    """Return how long a stop takes that a guest sends meanwhile [s]."""
    began = time.perf_counter()
    answer = client.post("/api/stop").json()
    took = time.perf_counter() - began
    assert answer["ok"], answer
    assert "waits" not in answer, answer
    return took


def report(seconds: float, rounds: int, seed: int, one_core: bool) -> Iterator[str]:
    """Yield the tables, line by line as they come."""
    with (
        tempfile.TemporaryDirectory(prefix="gh-") as name,
        virtual_board(Path(name), "--real-time") as board,
        DaemonProcess(Path(name)) as daemon,
        page_of(Path(name)) as page,
    ):
        assert daemon.process is not None
        assert page.process is not None
        if one_core:
            for pid in (board.process.pid, daemon.process.pid, page.process.pid):
                for thread in Path(f"/proc/{pid}/task").iterdir():
                    os.sched_setaffinity(int(thread.name), {0})
        daemon.wait_ticks(SETTLE_TICKS)
        guest, victim = page.client(Role.VIEW, "guest"), Victim.of(page.port, page.access)
        crowd = page.access.make_link(Role.VIEW, "crowd", DAY_S, None)
        entered = [page.access.enter(crowd, "") for _ in range(SESSIONS)]
        sessions = [found[0] for found in entered if found is not None]
        page.access.set_password("eve", Role.ADMIN, "the right one")
        processes = (("daemon", daemon.process.pid), ("page", page.process.pid))
        before = kept_state(page, daemon), [memory_of(str(pid)) for _, pid in processes]
        watches = [Watch(pid) for _, pid in processes]
        quiet, attacked, found = Phase(), Phase(), []
        for watch in watches:
            watch.start()
        for number in range(rounds):
            for phase in (quiet, attacked):
                storm = (
                    attacker(victim, sessions, seconds + 4.0, seed + number) if phase is attacked else None
                )
                time.sleep(2.0)  # for its start
                observe(phase, daemon, page.process.pid, seconds)
                if storm is not None:
                    found.append(json.loads(storm.communicate(timeout=120.0)[0]))
                    time.sleep(LEAVE_S)
        after = kept_state(page, daemon), [memory_of(str(pid)) for _, pid in processes]
        storm = attacker(victim, sessions, 15.0, seed + rounds)
        time.sleep(8.0)
        stop_s = stop_in_the_storm(guest)
        pins = board.truth()["pins"]
        storm.communicate(timeout=120.0)
        yield from _requests(found)
        yield from _lateness(quiet, attacked)
        yield ""
        yield f"{'memory, PSS [MB]':32} {'before':>8} {'highest':>8} {'after':>8}"
        for (name, _), begin, watch, end in zip(processes, before[1], watches, after[1], strict=True):
            yield _memory(name, begin, watch.end(), end)
        yield ""
        for what, value in before[0].items():
            same = after[0][what] == value
            yield f"{what:32} {'unchanged' if same else f'CHANGED: {value} {after[0][what]}'}"
        off = not pins["heater_relay"] and not pins["fan"]
        yield f"a guest's stop under attack: answered after {stop_s:.2f} s, outputs {'off' if off else 'ON'}"


def _requests(found: Sequence[dict[str, Any]]) -> Iterator[str]:
    sent, refused = (sum(each[key] for each in found) for key in ("sent", "refused"))
    got_in = [line for each in found for line in each["got_in"]]
    yield f"{found[0]['kinds']} distinct requests, {sent} sent, {refused} of them hung up on, no place free"
    yield f"{len(got_in)} answered otherwise than they should"
    yield from got_in[:10]


def _lateness(quiet: Phase, attacked: Phase) -> Iterator[str]:
    yield ""
    head = f"{len(quiet.late_ms)} ticks of 1 s each [ms]"
    yield f"{head:44} {'p50':>8} {'p90':>8} {'p99':>8} {'max':>8}"
    for name, key in (
        ("lateness of ticks", "late_ms"),
        ("time of decisions", "decide_ms"),
        ("lateness of a bare loop of time.sleep", "peer_ms"),
    ):
        found = [_percentiles(getattr(phase, key)) for phase in (quiet, attacked)]
        for what, row in zip(("quiet", "attacked", "ratio"), (*found, found[1] / found[0]), strict=True):
            yield f"{name if what == 'quiet' else '':38}{what:>6} " + " ".join(
                f"{value:8.2f}" for value in row
            )
    share = 100.0 * attacked.page_cpu_s / max(len(attacked.peer_ms), 1)
    yield f"the attacked page took {share:.0f} % of a core"


def _percentiles(values: Sequence[float]) -> Any:
    return np.percentile(values, (50, 90, 99, 100))


def _memory(name: str, begin: ProcessMemory, highest_mb: float, end: ProcessMemory) -> str:
    return f"{name:32} {begin.pss:8.1f} {highest_mb:8.1f} {end.pss:8.1f}"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.page_attack", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each quiet and each attacked phase")
    parser.add_argument("--rounds", type=int, default=4, help="phases of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--one-core", action="store_true", help="board, daemon and page share one core")
    parser.add_argument("--attack", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.attack:
        attack(given.attack)
        return 0
    print(f"python -m bench.page_attack {' '.join(sys.argv[1:])}")
    for line in report(given.seconds, given.rounds, given.seed, given.one_core):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
