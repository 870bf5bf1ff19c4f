"""python -m bench.outbox: how fast an outbox drains into a local mosquitto, and what kills cost.

The process under test stores and publishes some hundred ticks a second and is killed with -9 at random
moments; or the broker is. `missing` are ticks of the history that the subscriber never heard: a gap in their
sequence, by which they are asked for again.
"""

import argparse
import json
import os
import platform
import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

from edge.config import loading as config
from edge.config.settings import HistorySettings
from edge.core.clock import RealClock
from edge.core.messages import TickRecord
from edge.formats.tick_json import tick_json
from edge.mqtt.telemetry import Telemetry
from edge.storage import Outbox, Storage
from tests.support.broker import Broker, Listener
from tests.support.mqtt_rig import ROOT, ControlLoop, settings
from training.lab import Lab

REPOSITORY = Path(__file__).parent.parent
TICKS = f"{ROOT}/history/tick"
SETTLED_TICKS = 75  # by then each forecast has met its measurement
REAL_TICKS = 15
BROKER = "allow_anonymous true\nmax_queued_messages 0"


def real_ticks() -> list[TickRecord]:
    """Ticks of a daemon at its default settings: forecasts of four predictors and their skill."""
    with Lab(config.default()) as lab:
        lab.run(minutes=SETTLED_TICKS + REAL_TICKS)
    return lab.history[SETTLED_TICKS:]


def drain_rate(ticks: int, broker_lines: str, real: Sequence[TickRecord]) -> float:
    """Messages per second, out of SQLite and acknowledged by the broker, after an outage of `ticks` ticks.

    real : what each tick says, in turn; it is given another number and time
    """
    with tempfile.TemporaryDirectory() as folder:
        database = f"{folder}/history.db"
        storage = Storage(HistorySettings(path=database, queue_ticks=100_000), RealClock())
        first = storage.open()
        for number in range(ticks):
            tick = real[number % len(real)]
            storage.write(replace(tick, seq=first + number, utc=1.7e9 + 60 * number))
        assert storage.wait_written(first + ticks - 1, 120)
        with Broker(Path(folder), broker_lines) as broker, draining(broker.port, database) as outbox:
            start = time.perf_counter()
            wait_until_empty(outbox)
            rate = ticks / (time.perf_counter() - start)
        storage.close()
    return rate


def kill_daemon(process: list[subprocess.Popen[bytes]], broker: Broker, database: str) -> None:
    """-9, and a new start."""
    process[0].kill()
    process[0].wait()
    process[0] = publisher(broker.port, database)


def kill_broker(process: list[subprocess.Popen[bytes]], broker: Broker, database: str) -> None:
    """-9, and a new start; all that it held for its subscribers is gone."""
    broker.kill()
    broker.start()


def survive(kill: Callable[..., None], count: int, seed: int) -> tuple[int, int, int, int]:
    """Ticks stored, duplicates heard, ticks missing, ticks missing after a resend."""
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        database = f"{folder}/history.db"
        with Broker(Path(folder), BROKER) as broker, Listener(broker.port, TICKS) as listener:
            process = [publisher(broker.port, database)]
            for _ in range(count):
                time.sleep(moments.uniform(1.0, 3.0))
                kill(process, broker, database)
            time.sleep(3.0)
            process[0].kill()
            process[0].wait()
            with draining(broker.port, database) as outbox:
                wait_until_empty(outbox)
                settle(listener)
                duplicates = len(heard_numbers(listener)) - len(set(heard_numbers(listener)))
                gaps = missing(database, listener)
                for seq in gaps:
                    outbox.resend(seq, seq)
                wait_until_empty(outbox)
                settle(listener)
                return len(stored_numbers(database)), duplicates, len(gaps), len(missing(database, listener))


def publisher(port: int, database: str) -> subprocess.Popen[bytes]:
    """Start the process under test."""
    command = [sys.executable, str(REPOSITORY / "bench" / "support" / "publisher.py"), str(port), database]
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(REPOSITORY)})


@contextmanager
def draining(port: int, database: str) -> Iterator[Outbox]:
    """Telemetry at work, and a look at its outbox."""
    telemetry = Telemetry(
        settings(port), ControlLoop().ask, ControlLoop().post, lambda: Outbox(database, ROOT)
    )
    try:
        with closing(Outbox(database, ROOT)) as outbox:
            yield outbox
    finally:
        telemetry.close()


def wait_until_empty(outbox: Outbox) -> None:
    """Wait until the broker has acknowledged everything."""
    while outbox.depth():
        time.sleep(0.02)


def settle(listener: Listener) -> None:
    """Wait until the broker has handed over everything."""
    count = -1
    while count != len(listener.heard):
        count = len(listener.heard)
        time.sleep(1.0)


def heard_numbers(listener: Listener) -> list[int]:
    """Sequence numbers, with repeats."""
    return [tick["seq"] for tick in listener.objects(TICKS)]


def stored_numbers(database: str) -> set[int]:
    """Sequence numbers of the history."""
    with closing(sqlite3.connect(database)) as connection:
        return {seq for (seq,) in connection.execute("SELECT seq FROM ticks WHERE seq > 0")}


def missing(database: str, listener: Listener) -> list[int]:
    """Return the numbers that were stored and never received."""
    return sorted(stored_numbers(database) - set(heard_numbers(listener)))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=20_000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"python -m bench.outbox {' '.join(sys.argv[1:])}")
    print(f"python {platform.python_version()}, {platform.machine()}, seed {arguments.seed}\n")
    real = real_ticks()
    sizes = [len(json.dumps(tick_json(tick)).encode()) for tick in real]
    print(f"ticks of the default daemon, {min(sizes)} to {max(sizes)} bytes of JSON\n")
    print("| broker | messages/s drained |\n|---|---|")
    for name, lines in (("defaults", ""), ("max_inflight_messages 200", "\nmax_inflight_messages 200")):
        print(f"| mosquitto, {name} | {drain_rate(arguments.ticks, BROKER + lines, real):.0f} |", flush=True)
    print("\n| killed | times | ticks stored | duplicates | missing | missing after resend |")
    print("|---|---|---|---|---|---|")
    for name, kill in (("daemon", kill_daemon), ("broker", kill_broker)):
        row = survive(kill, arguments.kills, arguments.seed)
        print(f"| {name} | {arguments.kills} | " + " | ".join(map(str, row)) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
