"""Cost of the daemon at its default settings: 60 s steps and the packaged bundle with its four predictors.

The daemon runs in a process of its own, in lock-step with a virtual board, with history and MQTT on. The CPU
time of the lock-step (asking the simulated board to advance) is the bench's and is subtracted.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from edge.app.daemon import Daemon
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import virtual_rig
from edge.config import loading as config
from edge.core.clock import Port
from edge.core.messages import TickRecord
from edge.storage.file import connect

WARM_UP_TICKS = 120  # the estimator's history is full, and each forecast meets its measurement
SETTINGS = """
state_file: {folder}/state.json
control_socket: {{path: {folder}/daemon.sock}}
history: {{path: {folder}/history.db}}
board: {{port: {folder}/board}}
bundle: {{path: {folder}/bundles, trusted_keys: {folder}/keys}}
mqtt: {{enabled: true, host: 127.0.0.1, port: {port}, rig: rig-1}}
control: {{controller: {controller}}}
box: {{heater_w: 100}}
"""


@dataclass(frozen=True, slots=True)
class ProcessMemory:
    """Memory of one process [MB]: resident, its share of shared pages, private alone, highest resident."""

    rss: float
    pss: float
    uss: float
    peak: float

    def __str__(self) -> str:
        return f"{self.rss:6.1f} {self.pss:6.1f} {self.uss:6.1f} {self.peak:6.1f}"


@dataclass(frozen=True, slots=True)
class DaemonCost:
    """Cost of one daemon.

    cpu_ms : CPU time of all threads per tick [ms]
    threads : alive at the end
    """

    memory: ProcessMemory
    cpu_ms: float
    threads: int


class TimedClock(SimClock):
    """A simulated clock that sums up the CPU time of its own work."""

    own_s = 0.0

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Wait as `SimClock` does."""
        began = time.thread_time()
        super().wait(port, wake, until_s)
        self.own_s += time.thread_time() - began


def memory_of(pid: str) -> ProcessMemory:
    """Read the kernel's sums over all mappings."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    lines += [line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if "VmHWM" in line]
    kb = {line.split(":")[0]: int(line.split()[1]) for line in lines}
    private = kb["Private_Clean"] + kb["Private_Dirty"]
    return ProcessMemory(kb["Rss"] / 1024, kb["Pss"] / 1024, private / 1024, kb["VmHWM"] / 1024)


def cost(controller: str, broker_port: int, ticks: int, is_first_start: bool = False) -> DaemonCost:
    """Run a daemon for `ticks` after its warm-up, and return what it took.

    is_first_start : the daemon makes its history; else there is an empty one, as after a restart
    """
    with tempfile.TemporaryDirectory(prefix="gh-") as folder, virtual_rig(Path(folder), seed=1):
        if not is_first_start:
            connect(Path(folder) / "history.db", busy_s=1.0).close()
        options = [controller, folder, str(broker_port), str(ticks)]
        program = [sys.executable, "-m", "bench.default_daemon", *options]
        found = json.loads(subprocess.run(program, stdout=subprocess.PIPE, check=True).stdout)
    return DaemonCost(ProcessMemory(**found.pop("memory")), **found)


def measured_here(controller: str, folder: Path, broker_port: int, ticks: int) -> dict[str, Any]:
    """Run the daemon in this process and return its `DaemonCost` as a dictionary."""
    settings = config.parse(SETTINGS.format(folder=folder, port=broker_port, controller=controller), "bench")
    began = ended = (0.0, 0.0)
    memory, threads = ProcessMemory(0.0, 0.0, 0.0, 0.0), 0
    with closing(TimedClock(folder / "board.sock")) as clock:

        def look(record: TickRecord) -> None:
            nonlocal began, ended, memory, threads
            ended = (time.process_time(), clock.own_s)
            if record.seq == WARM_UP_TICKS:
                began = ended
            if record.seq == WARM_UP_TICKS + ticks:
                memory, threads = memory_of("self"), len(list(Path("/proc/self/task").iterdir()))

        stop_at_s = 60.0 * (WARM_UP_TICKS + ticks + 1) - 30.0
        with Daemon(settings, clock, after_tick=look, stop_at_s=stop_at_s) as daemon:
            daemon.run()
    process_s, lock_step_s = (end - begin for end, begin in zip(ended, began, strict=True))
    return {
        "memory": asdict(memory),
        "cpu_ms": 1e3 * (process_s - lock_step_s) / ticks,
        "threads": threads,
    }


def main() -> None:
    """Print one daemon's cost as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("controller")
    parser.add_argument("folder", type=Path)
    parser.add_argument("broker_port", type=int)
    parser.add_argument("ticks", type=int)
    options = parser.parse_args()
    print(json.dumps(measured_here(options.controller, options.folder, options.broker_port, options.ticks)))


if __name__ == "__main__":
    main()
