"""python -m bench.fleet_load: what a fleet costs each engine, and what would break first.

Simulated rigs send what real daemons send, one tick a minute over connections of their own; a few real
daemons on virtual boards are among them. A quarter and half of the rigs tick for a tenth of the time each,
then all of them for all of it; what a rig costs is the slope over these three.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from sqlalchemy import Engine, func, select
from sqlalchemy.orm import Session

from bench.default_daemon import memory_of
from bench.header import header
from bench.outbox import real_ticks
from edge.core.messages import TickRecord
from edge.formats.tick_json import tick_json
from edge.mqtt import states
from edge.tick.orders import Operation
from edge.tick.status import LoopStatus, status_json
from fleet.database.base import open_database
from fleet.database.tables import FleetRig, StoredSpan
from fleet.settings import DatabaseSettings
from tests.support.broker import Broker, wait_for
from tests.support.daemon_process import ROOT, DaemonProcess
from tests.support.ingest_process import IngestProcess
from tests.support.postgres import Postgres
from tests.support.victoria import Victoria
from tests.support.virtual_board import virtual_board

STEP_S = 60.0
SHARES = {0.25: 0.1, 0.5: 0.1, 1.0: 1.0}  # of the rigs -> of the time
SETTLE_SHARE, SETTLE_MAX_S = 1 / 3, 180.0  # of a part's time, in which rigs connect
SAMPLE_S = 5.0
GOAL_RIGS = 100_000
MB = 1 << 20  # [bytes]
STORED_S = 300.0  # patience for the last ticks
BROKER = (
    "allow_anonymous true\npersistence true\nmax_queued_messages 0\nmax_inflight_messages 0\n"
    "autosave_interval 60"
)
ENGINES = ("mosquitto", "VictoriaMetrics", "ingest", "PostgreSQL")
# Cores that an engine can use: the broker and Python have one thread that works, ingest one session of SQL.
CORES = {"mosquitto": 1, "VictoriaMetrics": os.cpu_count() or 1, "ingest": 1, "PostgreSQL": 1}
LAGS = {
    "mosquitto": "from a rig's publish to the broker's acknowledgement",
    "VictoriaMetrics": "to write a batch and sync it",
    "ingest": "from hearing a tick to having it stored",
    "PostgreSQL": "to read and write what a batch changes",
}


@dataclass(frozen=True, slots=True)
class EngineSample:
    """CPU time and memory of the engines at a moment. cpu_s, memory_mb : by engine"""

    utc: float
    cpu_s: Mapping[str, float]
    memory_mb: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class LoadPart:
    """A part of the time. rigs : that tick; begin_utc, end_utc : of its measured rest"""

    rigs: int
    begin_utc: float
    end_utc: float


@dataclass(slots=True)
class FleetLoad:
    """All of a run. lags_s : by engine, (utc, seconds)"""

    parts: list[LoadPart] = field(default_factory=list)
    samples: list[EngineSample] = field(default_factory=list)
    lags_s: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    ticks_sent: int = 0
    ticks_stored: int = 0
    disk_bytes: int = 0

    def cpu(self, engine: str, part: LoadPart) -> float:
        """Return cores in use, on average."""
        inside = [sample for sample in self.samples if part.begin_utc <= sample.utc <= part.end_utc]
        first, last = inside[0], inside[-1]
        return (last.cpu_s[engine] - first.cpu_s[engine]) / (last.utc - first.utc)

    def memory(self, engine: str, part: LoadPart) -> float:
        """Return the memory at its end [MB]."""
        return [sample for sample in self.samples if sample.utc <= part.end_utc][-1].memory_mb[engine]

    def lag(self, engine: str, part: LoadPart, share: float = 99.0) -> float:
        """Return a percentile of the lags, NaN without any [s]."""
        inside = [lag for utc, lag in self.lags_s[engine] if part.begin_utc <= utc <= part.end_utc]
        return float(np.percentile(inside, share)) if inside else float("nan")


@dataclass(frozen=True, slots=True)
class Growth:
    """A cost as a line over the number of rigs."""

    fixed: float
    per_rig: float

    def at(self, rigs: float) -> float:
        """Return the cost of so many."""
        return self.fixed + self.per_rig * rigs

    def rigs_at(self, limit: float) -> float:
        """Return how many rigs reach a limit, infinity where it was not seen to grow."""
        return max(0.0, (limit - self.fixed) / self.per_rig) if self.per_rig > 0.0 else float("inf")


def growth(rigs: Sequence[float], costs: Sequence[float]) -> Growth:
    """Fit the line by least squares."""
    slope, fixed = np.polyfit(rigs, costs, 1)
    return Growth(float(fixed), float(slope))


def templates(ticks: Sequence[TickRecord]) -> list[dict[str, str]]:
    """Return what each tick says on each topic, but for its first keys, number and time."""

    def rest(body: Mapping[str, object]) -> str:
        known = {key: value for key, value in body.items() if key not in ("seq", "utc")}
        return json.dumps(known, separators=(",", ":"))[1:]

    found = []
    for tick in ticks:
        status = status_json(LoopStatus(Operation("MPC-Twin-P"), 0.0, (), tick, tick.echo, True, {}))
        counters: dict[str, int | None] = {"ticks_late": 0, "ticks_skipped": 0, "outbox_depth": 1}
        live = {
            "state": states.state(status, counters),
            "decision": states.decision(status),
            "forecast": states.forecast(status),
            "forecasts": states.forecasts(status),
            "skill": states.skill(status),
            "drift": states.drift(status),
        }
        found.append(
            {"history/tick": rest(tick_json(tick)), **{topic: rest(body) for topic, body in live.items()}}
        )
    return found


@contextmanager
def real_daemons(folder: Path, count: int, port: int) -> Iterator[None]:
    """Run daemons with the packaged bundle on virtual boards, at the default step."""
    with ExitStack() as stack:
        for number in range(count):
            own = folder / f"real-{number}"
            own.mkdir()
            stack.enter_context(virtual_board(own))
            mqtt = {"rig": own.name}
            daemon = DaemonProcess(own, port, control={"step_s": STEP_S, "model": ""}, mqtt=mqtt)
            stack.callback(daemon.kill)
            daemon.launch()
            wait_for(daemon.seq, f"a tick of {own.name}, see {daemon.log}", patience_s=120.0)
        yield


def measure(folder: Path, rigs: int, minutes: float, daemons: int) -> FleetLoad:
    """Run the load; what was not stored in the end is a difference of two counts."""
    measured = FleetLoad()
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(folder, BROKER, is_verbose=False))
        victoria = stack.enter_context(Victoria(folder))
        postgres = stack.enter_context(Postgres())
        database = open_database(DatabaseSettings(url=postgres.url))
        stack.callback(database.dispose)
        ingest = stack.enter_context(
            IngestProcess(
                folder, {"port": broker.port}, victoria.url, postgres.url, batch_s=5.0, gap_wait_s=10.0
            )
        )
        stack.enter_context(real_daemons(folder, daemons, broker.port))
        field_ = stack.enter_context(rig_field(folder, broker.port, real_ticks()))
        running = (broker.process, victoria.process, ingest.process, postgres.process)
        pids = {name: one.pid for name, one in zip(ENGINES, running, strict=True) if one is not None}
        for share, of_time in SHARES.items():
            _load(measured, field_, pids, max(1, round(share * rigs)), of_time * minutes * 60.0, daemons)
        said, _ = field_.communicate("end\n", timeout=60.0)
        measured.ticks_sent = sum(json.loads(said).values())
        measured.ticks_stored = stored_ticks(database, measured.ticks_sent, daemons)
        files = (path for path in (folder / "numbers").rglob("*") if path.is_file())
        measured.disk_bytes = sum(path.stat().st_size for path in files)
        measured.lags_s = lags(ingest.journal, folder / "lags.txt")
    return measured


def stored_ticks(database: Engine, sent: int, daemons: int) -> int:
    """Return how many ticks of simulated rigs are stored; wait until that are all of them."""
    ticks = select(func.sum(StoredSpan.last_seq - StoredSpan.first_seq + 1))
    real = select(func.count()).where(FleetRig.name.startswith("real-"))
    deadline = time.monotonic() + STORED_S
    while True:
        with Session(database) as session:
            stored = int(session.scalar(ticks.where(StoredSpan.rig.startswith("sim-"))) or 0)
            heard = int(session.scalar(real) or 0)
        if stored >= sent or time.monotonic() > deadline:
            assert heard == daemons, f"{heard} of {daemons} real daemons were heard"
            return stored
        time.sleep(1.0)


def _load(
    measured: FleetLoad,
    field_: "subprocess.Popen[str]",
    pids: Mapping[str, int],
    rigs: int,
    seconds: float,
    daemons: int,
) -> None:
    """Let so many rigs tick for so long."""
    assert field_.stdin is not None
    field_.stdin.write(f"active {rigs}\n")
    field_.stdin.flush()
    now = time.time()
    begin, end = now + min(SETTLE_MAX_S, SETTLE_SHARE * seconds), now + seconds
    while time.time() < end:
        assert field_.poll() is None, "the simulated rigs have ended"
        measured.samples.append(sample(pids))
        time.sleep(min(SAMPLE_S, max(0.0, end - time.time())))
    measured.samples.append(sample(pids))
    measured.parts.append(LoadPart(rigs + daemons, begin, measured.samples[-1].utc))


def sample(pids: Mapping[str, int]) -> EngineSample:
    """Look at the engines, their children included."""
    cpu_s, memory_mb = {}, {}
    for name, pid in pids.items():
        tree = [pid, *children(pid)]
        cpu_s[name] = sum(cpu_time_s(one) for one in tree)
        memory_mb[name] = sum(memory_of(str(one)).pss for one in tree)
    return EngineSample(time.time(), cpu_s, memory_mb)


def children(pid: int) -> list[int]:
    """Return a process's own children; those of PostgreSQL have none."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def cpu_time_s(pid: int) -> float:
    """Return user and system time of a process, and of its children that have ended."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def rig_field(
    folder: Path, port: int, ticks: Sequence[TickRecord], step_s: float = STEP_S
) -> Iterator["subprocess.Popen[str]"]:
    """Start the simulated rigs; none ticks yet. ticks : that they send again and again"""
    known = folder / "templates.json"
    known.write_text(json.dumps(templates(ticks)), encoding="utf-8")
    words = [str(port), str(known), str(folder / "lags.txt"), str(step_s)]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.simulated_rigs", *words],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def lags(journal: Path, acknowledged: Path) -> dict[str, list[tuple[float, float]]]:
    """Return lags by engine: of ingest's journal, and of the rigs."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ENGINES}
    for line in journal.read_text(encoding="utf-8").splitlines():
        batch = json.loads(line)
        found["ingest"] += [(batch["utc"], lag) for lag in batch["lags_s"]]
        found["PostgreSQL"].append((batch["utc"], batch["database_s"]))
        if batch["stored"]:
            found["VictoriaMetrics"].append((batch["utc"], batch["numbers_s"]))
    for line in acknowledged.read_text(encoding="utf-8").splitlines():
        utc, lag = map(float, line.split())
        found["mosquitto"].append((utc, lag))
    return found


def load_table(measured: FleetLoad) -> Iterator[str]:
    """Lines of the first table."""
    yield "| rigs | engine | cores | memory, MB | lag p50, s | lag p99, s |"
    yield "|---|---|---|---|---|---|"
    for part in measured.parts:
        for name in ENGINES:
            numbers = f"{measured.cpu(name, part):.3f} | {measured.memory(name, part):.0f}"
            half, most = measured.lag(name, part, 50.0), measured.lag(name, part)
            yield f"| {part.rigs} | {name} | {numbers} | {half:.3f} | {most:.3f} |"
        cores, memory_mb = (sum(of(name, part) for name in ENGINES) for of in (measured.cpu, measured.memory))
        yield f"| {part.rigs} | together | {cores:.2f} | {memory_mb:.0f} | | |"
    yield ""
    yield from (f"lag of {name}: {text}" for name, text in LAGS.items())


def goal_table(measured: FleetLoad) -> Iterator[str]:
    """Lines of the second table, and what breaks first."""
    rigs = [float(part.rigs) for part in measured.parts]
    memory_max_mb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / MB
    at_goal = f"at {GOAL_RIGS} rigs"
    yield (
        f"| engine | CPU of a rig, ms/min | memory of a rig, kB | {at_goal}: cores | {at_goal}: memory, GB |"
        " cores it can use | rigs that fill them | rigs that fill the memory |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    ends: dict[str, float] = {}
    for name in ENGINES:
        cpu = growth(rigs, [measured.cpu(name, part) for part in measured.parts])
        memory = growth(rigs, [measured.memory(name, part) for part in measured.parts])
        ends[f"the CPU of {name}"] = cpu.rigs_at(CORES[name])
        ends[f"the memory, by {name}"] = memory.rigs_at(memory_max_mb)
        yield (
            f"| {name} | {60e3 * cpu.per_rig:.2f} | {1e3 * memory.per_rig:.1f} | {cpu.at(GOAL_RIGS):.1f} |"
            f" {memory.at(GOAL_RIGS) / 1e3:.1f} | {CORES[name]} | {cpu.rigs_at(CORES[name]):.0f} |"
            f" {memory.rigs_at(memory_max_mb):.0f} |"
        )
    first = min(ends, key=lambda name: ends[name])
    yield ""
    yield f"breaks first: {first}, at {ends[first]:.0f} rigs; the machine has {memory_max_mb / 1e3:.0f} GB"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=2000)
    parser.add_argument("--minutes", type=float, default=60.0, help="with all rigs (usual: 60)")
    parser.add_argument("--daemons", type=int, default=50)
    arguments = parser.parse_args()
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a rig has four connections
    print(f"python -m bench.fleet_load {' '.join(sys.argv[1:])}")
    print(*header(), sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(Path(folder), arguments.rigs, arguments.minutes, arguments.daemons)
    print(f"{arguments.daemons} of the rigs are real daemons; one tick a minute and rig\n")
    print(*load_table(measured), sep="\n")
    print()
    print(*goal_table(measured), sep="\n")
    per_tick = measured.disk_bytes / max(1, measured.ticks_stored)
    print(f"\nticks sent {measured.ticks_sent}, in store {measured.ticks_stored};", end=" ")
    print(f"VictoriaMetrics' folder has {per_tick:.0f} bytes a tick")
    return 0 if measured.ticks_stored == measured.ticks_sent else 1


if __name__ == "__main__":
    sys.exit(main())
