"""Floods at every door while a stop is sent: python -m bench.attack.floods --seed S --count N.

A daemon, a board in real time and a broker are processes of their own, as on a rig; so is the one who floods.
An emergency stop or maintenance must have every pin off within OBEYED_S, whichever door it comes through.
"""

import contextlib
import itertools
import multiprocessing
import random
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from bench.attack.part import TrialResult, main_of
from edge.core.errors import RequestError
from edge.sockets.client import request
from tests.support.broker import Broker, Listener
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import VirtualBoard, virtual_board
from tests.support.watched_clock import ACTUATORS

OBEYED_S = 1.0
GIVE_UP_S = 30.0
WARM_UP_S = 1.0  # a flood has run this long when the stop is sent
NO_HOLD = {"fan_min_on_s": 0.0, "fan_min_off_s": 0.0}  # the fan runs again as soon as a stop is released
CLIENTS = 40  # more than the control socket has places
BROKER = "allow_anonymous true\nmax_queued_messages 0\nmax_inflight_messages 0"

# Floods of the control socket. Each runs until it is killed.


def idle(path: Path, port: int) -> None:
    """Open connections that say nothing."""
    clients = [_client(path) for _ in range(CLIENTS)]
    while clients:
        time.sleep(0.05)
        clients = [client for client in clients if _is_open(client)] + [_client(path)]


def half_lines(path: Path, port: int) -> None:
    """Open connections that never end their line."""
    clients = [_client(path) for _ in range(CLIENTS)]
    while True:
        for number, client in enumerate(clients):
            try:
                client.sendall(b'{"do": "status", ')
            except OSError:
                clients[number] = _client(path)
        time.sleep(0.01)


def never_read(path: Path, port: int) -> None:
    """Send requests and never read the answers."""
    clients = [_client(path) for _ in range(CLIENTS)]
    for client in clients:
        client.setblocking(False)
    while True:
        for number, client in enumerate(clients):
            try:
                client.send(b'{"do": "status"}\n' * 100)
            except BlockingIOError:
                continue
            except OSError:
                clients[number] = _client(path)
                clients[number].setblocking(False)


def requests_of(line: bytes) -> Callable[[Path, int], None]:
    """Return a flood of one kind of request from many clients, as fast as they are answered."""

    def flood(path: Path, port: int) -> None:
        clients = [_client(path) for _ in range(16)]
        while True:
            for number, client in enumerate(clients):
                try:
                    client.sendall(line)
                    client.recv(1 << 20)
                except OSError:
                    clients[number] = _client(path)

    return flood


def comings_and_goings(path: Path, port: int) -> None:
    """Open connections and close them at once."""
    while True:
        _client(path).close()


# Floods of the broker.


def burst(path: Path, port: int) -> None:
    """Ten thousand messages at once."""
    _publish(port, itertools.repeat(("status", b"PRESS"), 10_000), pause_s=0.0)
    time.sleep(GIVE_UP_S)


def steady(topic: str, payload: bytes) -> Callable[[Path, int], None]:
    """One message every half millisecond, without end."""
    return lambda path, port: _publish(port, itertools.repeat((topic, payload)), pause_s=0.0005)


FLOODS: dict[str, Callable[[Path, int], None]] = {
    "no flood": lambda path, port: time.sleep(GIVE_UP_S),
    "socket: idle": idle,
    "socket: half lines": half_lines,
    "socket: never read": never_read,
    "socket: status": requests_of(b'{"do": "status"}\n'),
    "socket: why": requests_of(b'{"do": "why"}\n'),
    "socket: orders": requests_of(b'{"do": "set_reference", "reference_c": 30}\n'),
    "socket: garbage": requests_of(b"\xff" * 70_000 + b"\n"),
    "socket: come and go": comings_and_goings,
    "mqtt: 10 000 at once": burst,
    "mqtt: status": steady("status", b"PRESS"),
    "mqtt: orders": steady("temperature", b"30"),
    "mqtt: why": steady("why", b""),
    "mqtt: 50 kB": steady("temperature", b"9" * 50_000),
    "mqtt: unknown": steady("nothing/such", b"\xff\x00"),
}
STOPS = {
    "emergency_stop": ({"do": "emergency_stop"}, ("emergency_stop", "PRESS")),
    "maintenance": ({"do": "maintenance", "minutes": 5}, ("maintenance", "5")),
}


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """`count` stops: each flood, door and kind of stop in a drawn order, again and again."""
    trials = [(flood, door, stop) for flood in FLOODS for door in ("socket", "mqtt") for stop in STOPS]
    random.Random(seed).shuffle(trials)
    with tempfile.TemporaryDirectory(prefix="gh-flood-") as name:
        folder = Path(name)
        with (
            Broker(folder, BROKER) as broker,
            virtual_board(folder, "--real-time") as board,
            DaemonProcess(folder, broker.port, safety=NO_HOLD) as daemon,
            Listener(broker.port, f"{RIG}/nothing") as sender,
        ):
            for flood, door, stop in itertools.islice(itertools.cycle(trials), count):
                name = f"{flood}, {stop} by {door}"
                if not _heat(board, daemon):
                    yield TrialResult(
                        name, 1, ["heater and fan are not on after the release of the stop before"]
                    )
                    continue
                took_s = stopped_after(flood, door, stop, board, daemon, sender, broker.port)
                yield TrialResult(name, 1, _slow(took_s, daemon))


def stopped_after(
    flood: str, door: str, stop: str, board: VirtualBoard, daemon: DaemonProcess, sender: Listener, port: int
) -> float:
    """Time from the sending of a stop until every pin is off [s]; GIVE_UP_S where that did not come."""
    flooder = multiprocessing.get_context("fork").Process(
        target=FLOODS[flood], args=(daemon.socket, port), daemon=True
    )
    flooder.start()
    try:
        time.sleep(WARM_UP_S)
        begin = time.monotonic()
        with _send(stop, door, daemon.socket, sender):
            while _pins_on(board) and time.monotonic() - begin < GIVE_UP_S:
                time.sleep(0.01)
            return time.monotonic() - begin
    finally:
        flooder.kill()
        flooder.join()


@contextlib.contextmanager
def _send(stop: str, door: str, path: Path, sender: Listener) -> Iterator[None]:
    """Send without waiting for the answer: what counts is when the pins are off."""
    order, (topic, payload) = STOPS[stop]
    if door == "mqtt":
        sender.client.publish(f"{RIG}/set/{topic}", payload, qos=1)
        yield
        return
    asking = threading.Thread(target=_ask, args=(path, order), daemon=True)
    asking.start()
    yield
    asking.join()


def _ask(path: Path, order: dict[str, Any]) -> None:
    with contextlib.suppress(RequestError):
        request(path, order, GIVE_UP_S)


def _heat(board: VirtualBoard, daemon: DaemonProcess) -> bool:
    """Release all stops, heater, fan and light on; False where they do not come on."""
    deadline = time.monotonic() + GIVE_UP_S
    while not {"heater_relay", "fan", "led"} <= set(_pins_on(board)):
        if time.monotonic() > deadline:
            return False
        for order in (
            {"do": "release_emergency_stop"},
            {"do": "maintenance", "minutes": 0},
            {"do": "clear_trip"},
            {"do": "set_manual", "heater_duty": 1.0, "fan_on": 1, "led": 1.0},
        ):
            with contextlib.suppress(Exception):
                request(daemon.socket, order, timeout_s=5.0)
        time.sleep(0.2)
    return True


def _pins_on(board: VirtualBoard) -> list[str]:
    pins = board.truth()["pins"]
    return [name for name in ACTUATORS if pins[name]]


def _slow(took_s: float, daemon: DaemonProcess) -> list[str]:
    assert daemon.process is not None
    if daemon.process.poll() is not None:
        return [f"the daemon has ended: {daemon.log.strip().splitlines()[-1:]}"]
    return [f"every pin off after {took_s:.2f} s"] if took_s > OBEYED_S else []


def _client(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    client.settimeout(2.0)
    with contextlib.suppress(OSError):
        client.connect(str(path))
    return client


def _is_open(client: socket.socket) -> bool:
    client.setblocking(False)
    try:
        return client.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def _publish(port: int, messages: Iterator[tuple[str, bytes]], pause_s: float) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    client = Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    for topic, payload in messages:
        client.publish(f"{RIG}/set/{topic}", payload, qos=0)
        if pause_s:
            time.sleep(pause_s)


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 4 * len(FLOODS), "floods", __doc__))
