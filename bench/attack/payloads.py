"""Hostile MQTT payloads: python -m bench.attack.payloads --seed S --count N.

Random topics and payloads go through a real broker to a real daemon, slowly enough to pass its limits on
floods. The daemon goes on ticking, its standing orders stay legal, its history stays whole, and a stop is
obeyed afterwards.
"""

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.attack.part import TrialResult, evil_document, evil_raw, evil_text, main_of
from edge.mqtt.commands import COMMANDS
from tests.support.broker import Broker, Listener, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import VirtualBoard, virtual_board
from tests.support.watched_clock import ACTUATORS

STOP_WITHIN_S = 2.0  # through the broker, on a machine that is busy with all of this
BATCH = 100  # payloads between two looks at the daemon
PAUSE_S = 0.02  # between two payloads
HONEST: dict[str, Any] = {"heater_duty": 0.5, "fan_on": 1, "led": 0.5, "first_seq": 1, "last_seq": 3}
WORDS = ("PRESS", "auto", "heat", "off", "manual", "fan_only", "on", "24", "35.5", "MPC", "rules", "5", "0")
# Those that stop the rig are left out: the rig shall go on deciding.
TOPICS = tuple(each for each in COMMANDS if each not in ("emergency_stop", "maintenance"))


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """Batches of payloads; after each the daemon is looked at."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="gh-payload-") as name:
        folder = Path(name)
        with (
            Broker(folder) as broker,
            virtual_board(folder, "--real-time") as board,
            DaemonProcess(folder, broker.port) as daemon,
            Listener(broker.port, f"{RIG}/nothing") as sender,
        ):
            for first in range(0, count, BATCH):
                size = min(BATCH, count - first)
                before = daemon.seq()
                for _ in range(size):
                    topic, payload = _message(rng)
                    sender.client.publish(f"{RIG}/set/{topic}", payload, qos=int(rng.integers(3)))
                    time.sleep(PAUSE_S)
                yield TrialResult(f"payloads {first} to {first + size - 1}", size, _look(daemon, before))
            sender.send(f"{RIG}/set/emergency_stop", "PRESS")
            yield TrialResult("the stop afterwards", 0, _still_on(board))


def _still_on(board: VirtualBoard) -> list[str]:
    deadline = time.monotonic() + STOP_WITHIN_S
    while on := [name for name in ACTUATORS if board.truth()["pins"][name]]:
        if time.monotonic() > deadline:
            return [f"{', '.join(on)} on {STOP_WITHIN_S:g} s after the stop"]
        time.sleep(0.02)
    return []


def _message(rng: np.random.Generator) -> tuple[str, bytes]:
    topic = str(rng.choice(TOPICS))
    if rng.random() < 0.1:
        # A broker closes the line of a client whose topic it finds malformed: only what it lets through.
        topic = "".join(each for each in evil_text(rng)[:40] if each.isalnum() and ord(each) < 0xD800) or "x"
    kind = rng.random()
    if kind < 0.3:
        return topic, str(rng.choice(WORDS)).encode()
    return topic, evil_document(rng, HONEST) if kind < 0.7 else evil_raw(rng)


def _look(daemon: DaemonProcess, before: int) -> list[str]:
    """Return the present faults of the daemon."""
    assert daemon.process is not None
    if daemon.process.poll() is not None:
        return [f"the daemon has ended: {daemon.log.strip().splitlines()[-1:]}"]
    wait_for(lambda: daemon.seq() > before + 1, "two ticks")
    status = daemon.ask("status")
    json.dumps(status, allow_nan=False)
    last = status["tick"]["seq"]
    wait_for(lambda: (daemon.seqs() or [0])[-1] >= last, "the last tick is stored")
    operation, seqs = status["operation"], daemon.seqs()
    found = []
    if seqs != list(range(seqs[0], seqs[0] + len(seqs))):
        found.append("ticks are missing in the history")
    if operation["emergency_stop"] or operation["maintenance_until_utc"]:
        found.append(f"stopped by a payload: {operation}")
    if operation["reference_c"] is not None and not 5.0 <= operation["reference_c"] <= 45.0:
        found.append(f"reference {operation['reference_c']}")
    if not 0.0 <= operation["manual"]["heater_duty"] <= 1.0:
        found.append(f"manual duty {operation['manual']['heater_duty']}")
    if "Traceback" in daemon.log:
        found.append("a traceback on the daemon's output")
    return found


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 2000, "payloads", __doc__))
