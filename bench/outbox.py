"""python -m bench.outbox: how fast an outbox drains into a local mosquitto, and what kills cost.

The process under test stores and publishes some hundred ticks a second and is killed with -9 at random
moments; or the broker is. `missing` are ticks of the history that the subscriber never heard: a gap in their
sequence, by which they are asked for again.
"""

import argparse
import os
import platform
import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from edge.clock import RealClock
from edge.mqtt.telemetry import Telemetry
from edge.settings import HistorySettings
from edge.storage import Outbox, Storage
from tests.broker import Broker, Listener
from tests.mqtt_rig import ROOT, ControlLoop, record, settings

REPOSITORY = Path(__file__).parent.parent
TICKS = f"{ROOT}/history/tick"
BROKER = "allow_anonymous true\nmax_queued_messages 0"


def drain_rate(ticks: int, config: str) -> float:
    """Messages per second, out of SQLite and acknowledged by the broker, after an outage of `ticks` ticks."""
    with tempfile.TemporaryDirectory() as folder:
        database = f"{folder}/history.db"
        storage = Storage(HistorySettings(path=database, queue_ticks=100_000), RealClock())
        first = storage.open()
        for number in range(ticks):
            storage.write(record(first + number, utc=1.7e9 + 60 * number))
        assert storage.wait_written(first + ticks - 1, 120)
        with Broker(Path(folder), config) as broker, draining(broker.port, database) as outbox:
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
                duplicates = len(heard(listener)) - len(set(heard(listener)))
                gaps = missing(database, listener)
                for seq in gaps:
                    outbox.resend(seq, seq)
                wait_until_empty(outbox)
                settle(listener)
                return len(stored(database)), duplicates, len(gaps), len(missing(database, listener))


def publisher(port: int, database: str) -> subprocess.Popen[bytes]:
    """The process under test."""
    command = [sys.executable, str(REPOSITORY / "tests" / "publisher.py"), str(port), database]
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
    """The broker has acknowledged all."""
    while outbox.depth():
        time.sleep(0.02)


def settle(listener: Listener) -> None:
    """The broker has handed over all it had."""
    count = -1
    while count != len(listener.heard):
        count = len(listener.heard)
        time.sleep(1.0)


def heard(listener: Listener) -> list[int]:
    """Sequence numbers, with repeats."""
    return [tick["seq"] for tick in listener.objects(TICKS)]


def stored(database: str) -> set[int]:
    """Sequence numbers of the history."""
    with closing(sqlite3.connect(database)) as connection:
        return {seq for (seq,) in connection.execute("SELECT seq FROM ticks WHERE seq > 0")}


def missing(database: str, listener: Listener) -> list[int]:
    """What was stored and never heard."""
    return sorted(stored(database) - set(heard(listener)))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=20_000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"python -m bench.outbox {' '.join(sys.argv[1:])}")
    print(f"python {platform.python_version()}, {platform.machine()}, seed {arguments.seed}\n")
    print("| broker | messages/s drained |\n|---|---|")
    for name, config in (("defaults", ""), ("max_inflight_messages 200", "\nmax_inflight_messages 200")):
        print(f"| mosquitto, {name} | {drain_rate(arguments.ticks, BROKER + config):.0f} |", flush=True)
    print("\n| killed | times | ticks stored | duplicates | missing | missing after resend |")
    print("|---|---|---|---|---|---|")
    for name, kill in (("daemon", kill_daemon), ("broker", kill_broker)):
        row = survive(kill, arguments.kills, arguments.seed)
        print(f"| {name} | {arguments.kills} | " + " | ".join(map(str, row)) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
