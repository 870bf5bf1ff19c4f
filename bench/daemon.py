"""python -m bench.daemon: memory, CPU per tick, start, jitter and bytes of history of the daemon.

Memory, CPU and history at the default settings (60 s steps, the packaged bundle) in simulated time, MQTT on;
start and jitter in real time at 1 s steps. In the same run: memory of python and its packages alone, and a
bare loop of time.sleep for the jitter.
"""

import argparse
import platform
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bench.default_daemon import SETTINGS, ProcessMemory, cost, memory_of
from edge.config import loading as config
from edge.core.messages import TickRecord
from edge.storage import Outbox
from tests.support.broker import Broker, wait_for
from tests.support.daemon_process import RIG, ROOT, DaemonProcess, run_command
from tests.support.virtual_board import virtual_board
from training.lab import Lab

WARM_UP_TICKS = 10
DAY_TICKS = 1440  # at 60 s steps
CONTROLLERS = ("rules", "MPC-P", "MPC-Twin-P")
PACKAGES = {
    "python": "",
    "python, numpy": "import numpy",
    "python, scipy.optimize, sqlite_utils": "import scipy.optimize, sqlite_utils",
    "daemon's code, default bundle loaded": (
        "import edge.app.daemon; from pathlib import Path; from edge.bundle.store import BundleStore; "
        "from edge.bundle.predictors import loader; "
        "kept = BundleStore(Path('/nonexistent'), Path('/nonexistent'), loader(60.0)).load('packaged')"
    ),
}


@dataclass(frozen=True, slots=True)
class Lateness:
    """Delays of a daemon's ticks, and of the wake-ups of a bare loop in the same time [ms]."""

    daemon_ms: Sequence[float]
    peer_ms: Sequence[float]


def memory_with(imports: str) -> ProcessMemory:
    """Return the memory of an idle interpreter with these imports."""
    program = f"{imports}\nprint(flush=True)\ninput()"
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as peer:
        assert peer.stdout is not None
        peer.stdout.readline()
        memory = memory_of(str(peer.pid))
        peer.communicate(b"\n")
    return memory


def start_s(daemon: DaemonProcess) -> float:
    """From the start of the process to its first tick on standard output [s]."""
    began = time.perf_counter()
    with subprocess.Popen(run_command(daemon.config), stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        process.stdout.readline()
        took = time.perf_counter() - began
        process.terminate()
        process.communicate()
    return took


@contextmanager
def rig() -> Iterator[tuple[Path, Broker]]:
    """Yield a folder with a board in real time, and a broker."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        folder = Path(name)
        with virtual_board(folder, "--real-time"), Broker(folder) as broker:
            yield folder, broker


def start_times(count: int) -> tuple[float, list[float]]:
    """Return the time of a first start, which makes the history, and of `count` later ones [s]."""
    with rig() as (folder, broker):
        daemon = DaemonProcess(folder, broker.port)
        first = start_s(daemon)
        return first, [start_s(daemon) for _ in range(count)]


def lateness(seconds: float, controller: str) -> Lateness:
    """Run a daemon for so long, after some ticks to settle."""
    with rig() as (folder, broker):
        settings = {"controller": controller}
        with DaemonProcess(folder, broker.port, control=settings) as daemon:
            first = daemon.wait_ticks(WARM_UP_TICKS)
            peer = bare_loop(seconds)
            last = daemon.seq()
            wait_for(lambda: daemon.seqs()[-1] >= last)
            late = daemon.rows(f"SELECT late_s FROM ticks WHERE seq BETWEEN {first + 1} AND {last}")
    return Lateness([1e3 * late_s for (late_s,) in late], peer)


def bare_loop(seconds: float) -> list[float]:
    """How late time.sleep wakes on a grid of 1 s [ms]."""
    start, late = time.monotonic(), []
    for step in range(1, round(seconds) + 1):
        time.sleep(max(0.0, start + step - time.monotonic()))
        late.append(1e3 * (time.monotonic() - start - step))
    return late


def history_bytes_per_day(hours: float) -> float:
    """Pages in use after `hours` in lock-step at 60 s steps, all sent, less those after half of them."""
    pages: list[int] = []
    with tempfile.TemporaryDirectory(prefix="gh-") as name, Broker(Path(name)) as broker:
        folder = Path(name)
        text = SETTINGS.format(folder=folder, port=broker.port, controller="MPC-P")
        settings = config.parse(text, "bench")
        ticks = round(60 * hours)

        def look(record: TickRecord) -> None:
            if record.seq in (ticks // 2, ticks):
                wait_for(lambda: waiting(folder / "history.db") == 0)
                pages.append(bytes_in_use(folder / "history.db"))

        with Lab(settings, folder=folder, on_tick=look) as lab:
            lab.run(minutes=ticks + 1)
    return (pages[1] - pages[0]) / (ticks - ticks // 2) * DAY_TICKS


def waiting(path: Path) -> int:
    """Messages that the broker does not have yet; the newest tick's may not be written yet."""
    with closing(Outbox(path, RIG)) as outbox:
        return outbox.depth()


def bytes_in_use(path: Path) -> int:
    """Return the size of the file without free pages."""
    with closing(sqlite3.connect(path)) as connection:
        size, count, free = (
            connection.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("page_size", "page_count", "freelist_count")
        )
    return int(size * (count - free))


def percentiles(values: Sequence[float]) -> str:
    """p50, p99, max."""
    p50, p99, most = np.percentile(values, [50, 99, 100])
    return f"{p50:7.2f} {p99:7.2f} {most:7.2f}"


def default_costs(ticks: int) -> Iterator[str]:
    """Yield the table of memory and CPU at the default settings."""
    runs = [(name, False) for name in CONTROLLERS] + [(CONTROLLERS[-1], True)]
    yield f"{f'{ticks} ticks of 60 s; [MB], [ms]':40}    RSS    PSS    USS   peak  CPU per tick  threads"
    with tempfile.TemporaryDirectory(prefix="gh-") as name, Broker(Path(name)) as broker:
        for controller, is_first_start in runs:
            found = cost(controller, broker.port, ticks, is_first_start)
            text = f"{controller}, with a history just made" if is_first_start else controller
            yield f"{text:40} {found.memory} {found.cpu_ms:13.1f} {found.threads:8}"


def report(seconds: float, starts: int, hours: float) -> Iterator[str]:
    """Yield the tables, line by line as they come."""
    yield f"python {platform.python_version()}, numpy {np.__version__}, onnxruntime {version('onnxruntime')}"
    yield ""
    yield from default_costs(round(60 * hours))
    yield ""
    yield "memory of what it imports [MB]              RSS    PSS    USS   peak"
    for name, imports in PACKAGES.items():
        yield f"{name:40} {memory_with(imports)}"
    yield ""
    first, later = start_times(starts)
    yield "start of the process to its first tick [s] median    max"
    yield f"{f'{starts} starts':40} {statistics.median(later):8.2f} {max(later):6.2f}"
    yield f"{'the first, which makes the history':40} {first:8.2f} {first:6.2f}"
    yield ""
    late = lateness(seconds, "MPC")
    yield f"{f'lateness of ticks of 1 s over {seconds:g} s [ms]':40}     p50     p99     max"
    yield f"{'daemon, MPC':40} {percentiles(late.daemon_ms)}"
    yield f"{'bare loop of time.sleep beside it':40} {percentiles(late.peer_ms)}"
    yield ""
    daily = history_bytes_per_day(hours)
    size = f"{daily / 1e6:.2f} MB a day, {daily / DAY_TICKS:.0f} bytes a tick"
    yield f"history at 60 s steps, from {hours:g} h in lock-step: {size}"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.daemon", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of the run with the MPC")
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--hours", type=float, default=12.0, help="simulated, for the size of the history")
    arguments = parser.parse_args()
    print(f"python -m bench.daemon {' '.join(sys.argv[1:])}")
    for line in report(arguments.seconds, arguments.starts, arguments.hours):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
