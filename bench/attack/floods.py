"""Floods at every door while a stop is sent: python -m bench.attack.floods --seed S --count N.

Two rigs (daemon and board in real time), a page, a broker and the flooder are separate processes. Each
flood goes to the first rig. An emergency stop or maintenance must switch every pin off within OBEYED_S,
whichever door it comes through.

`greenhouse emergency-stop` must do so at both rigs, name both, and exit with 0. Its time begins when its
loaded process is released: parsing, the search for the rigs and the connections count; the start of
Python and the imports do not.
"""

import contextlib
import itertools
import multiprocessing
import random
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import requests
from paho.mqtt.client import Client as MqttClient
from paho.mqtt.enums import CallbackAPIVersion

from bench.attack.part import TrialResult, main_of
from bench.kills import FAN_FREE
from edge.page.access import Role
from edge.page.protocol import CONNECTIONS_MAX
from edge.sockets.client import request
from tests.support import separate_machine
from tests.support.broker import Broker, Listener
from tests.support.daemon_process import RIG, ROOT, DaemonProcess
from tests.support.page_process import Client, page_of
from tests.support.virtual_board import VirtualBoard, virtual_board
from tests.support.watched_clock import ACTUATORS

OBEYED_S = 1.0
GIVE_UP_S = 30.0
WARM_UP_S = 1.0  # a flood has run this long when the stop is sent
NAMES = ("rig-1", "rig-2")
COMMAND = "command line"
CLIENTS = 40  # more than the control socket has places
BROKER = "allow_anonymous true\nmax_queued_messages 0\nmax_inflight_messages 0"

# Floods of the control socket. Each runs until it is killed.


def idle(path: Path, port: int, page: int) -> None:
    """Open connections that say nothing."""
    clients = [_client(path) for _ in range(CLIENTS)]
    while clients:
        time.sleep(0.05)
        clients = [client for client in clients if _is_open(client)] + [_client(path)]


def half_lines(path: Path, port: int, page: int) -> None:
    """Open connections that never end their line."""
    clients = [_client(path) for _ in range(CLIENTS)]
    while True:
        for number, client in enumerate(clients):
            try:
                client.sendall(b'{"do": "status", ')
            except OSError:
                clients[number] = _client(path)
        time.sleep(0.01)


def never_read(path: Path, port: int, page: int) -> None:
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


def requests_of(line: bytes) -> Callable[[Path, int, int], None]:
    """Return a flood of one kind of request from many clients, as fast as they are answered."""

    def flood(path: Path, port: int, page: int) -> None:
        clients = [_client(path) for _ in range(16)]
        while True:
            for number, client in enumerate(clients):
                try:
                    client.sendall(line)
                    client.recv(1 << 20)
                except OSError:
                    clients[number] = _client(path)

    return flood


def comings_and_goings(path: Path, port: int, page: int) -> None:
    """Open connections and close them at once."""
    while True:
        _client(path).close()


# Floods of the broker.


def burst(path: Path, port: int, page: int) -> None:
    """Ten thousand messages at once."""
    _publish(port, itertools.repeat(("status", b"PRESS"), 10_000), pause_s=0.0)
    time.sleep(GIVE_UP_S)


def steady(topic: str, payload: bytes) -> Callable[[Path, int, int], None]:
    """One message every half millisecond, without end."""
    return lambda path, port, page: _publish(port, itertools.repeat((topic, payload)), pause_s=0.0005)


# Floods of the page.


def connections(begun: bytes) -> Callable[[Path, int, int], None]:
    """Return a flood of more connections than the page takes, each with the beginning of a request."""

    def flood(path: Path, port: int, page: int) -> None:
        held: deque[socket.socket] = deque(maxlen=CONNECTIONS_MAX + 10)
        while True:
            with contextlib.suppress(OSError):
                held.append(socket.create_connection(("127.0.0.1", page), timeout=2.0))
                held[-1].sendall(begun)
            time.sleep(0.0 if len(held) < CONNECTIONS_MAX else 0.01)

    return flood


def logins(path: Path, port: int, page: int) -> None:
    """Try passwords of invented names."""
    client = Client(f"http://127.0.0.1:{page}")
    for number in itertools.count():
        with contextlib.suppress(requests.RequestException):
            client.post("/api/session", {"name": f"nobody {number}", "password": "guess"})


BODY = (
    b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer x\r\n"
    b"Content-Type: application/json\r\nContent-Length: 9\r\n\r\n"
)
FLOODS: dict[str, Callable[[Path, int, int], None]] = {
    "no flood": lambda path, port, page: time.sleep(GIVE_UP_S),
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
    "page: idle": connections(b""),
    "page: half heads": connections(b"GET / HTTP/1.1\r\n"),
    "page: half bodies": connections(BODY),
    "page: logins": logins,
}
# Wordings of a stop by door. Any of them asks for one.
WORDS: dict[str, tuple[Any, ...]] = {
    "socket": (
        *(
            b'{"do": "emergency_stop"}',
            b'{"do": "emergency_stop", "state": "ON"}',
            b'{"do": "Emergency-Stop"}',
        ),
        *(b'{"do": "stop"}', b'{"do": "ask", "words": "Stop!"}', b"EMERGENCY STOP", b"stop"),
        b'{"do": "maintenance", "minutes": 5}',
    ),
    "mqtt": (
        *(
            ("emergency_stop", payload)
            for payload in (b"PRESS", b"ON", b"on", b"true", b"1", b"off", b"\xff")
        ),
        *(("mode", b"emergency_stop"), ("ask", b"stop"), ("maintenance", b"5")),
    ),
    "page": (
        *(("/api/stop", {}), ("/api/stop", {"reason": 5}), ("/api/order", {"do": "emergency_stop", "x": 1})),
        *(("/api/order", {"do": "stop"}), ("/api/order", {"do": "ask", "words": "emergency stop"})),
    ),
    COMMAND: ("emergency-stop",),
}


class _Daemon(DaemonProcess):
    """A daemon that registers in the run folder of a machine without other rigs."""

    @property
    def command(self) -> list[str]:
        return separate_machine.command(self.config.parent.parent, "run", "--config", str(self.config))


@contextmanager
def _rig(machine: Path, name: str, broker: Broker) -> Iterator[tuple[VirtualBoard, DaemonProcess]]:
    folder = machine / name
    folder.mkdir()
    with (
        virtual_board(folder, "--real-time") as board,
        _Daemon(folder, broker.port, safety=FAN_FREE, mqtt={"rig": name}) as daemon,
    ):
        yield board, daemon


class _Command:
    """`greenhouse WORDS` as a process that has loaded its modules and waits for `go`."""

    def __init__(self, machine: Path, *words: str) -> None:
        self.output = ""
        self._process = subprocess.Popen(
            separate_machine.command(machine, separate_machine.WAIT, *words),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=ROOT,
        )  # fmt: skip
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == separate_machine.LOADED

    def go(self) -> None:
        """Run the command to its end."""
        try:
            self.output = self._process.communicate(b"\n", timeout=GIVE_UP_S)[0].decode()
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def violations(self) -> list[str]:
        """Say what the command did other than report a stop of each rig."""
        stopped = sorted(f"{name}: stopped" for name in NAMES)
        if self._process.returncode == 0 and sorted(self.output.splitlines()) == stopped:
            return []
        return [f"exit code {self._process.returncode} of the command, which printed {self.output!r}"]


def run(seed: int, count: int) -> Iterator[TrialResult]:
    """`count` stops: each flood, door and kind of stop in a drawn order, again and again."""
    draw = random.Random(seed)
    trials = [(flood, door, draw.choice(WORDS[door])) for flood in FLOODS for door in WORDS]
    draw.shuffle(trials)
    with ExitStack() as stack:
        machine = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gh-flood-")))
        broker = stack.enter_context(Broker(machine, BROKER))
        rigs = [stack.enter_context(_rig(machine, name, broker)) for name in NAMES]
        daemon = rigs[0][1]
        sender = stack.enter_context(Listener(broker.port, f"{RIG}/nothing"))
        page = stack.enter_context(page_of(machine / NAMES[0]))
        for flood, door, words in itertools.islice(itertools.cycle(trials), count):
            name = f"{flood}, {words!r} by {door}"
            reached = rigs if door == COMMAND else rigs[:1]
            if not all(_heat(*rig) for rig in reached):
                yield TrialResult(
                    name, 1, ["heater and light are not on after the release of the stop before"]
                )
                continue
            flooder = partial(FLOODS[flood], daemon.socket, broker.port, page.port)
            command = _Command(machine, words) if door == COMMAND else None
            send = partial(_send, door, words, daemon.socket, sender, page.client(Role.VIEW))
            took_s = stopped_after(flooder, command.go if command else send, [board for board, _ in reached])
            found = [text for _, each in reached for text in _early_end(each)] or _slow(took_s)
            yield TrialResult(name, 1, [*found, *(command.violations() if command else ())])


def stopped_after(
    flood: Callable[[], None], send: Callable[[], None], boards: Sequence[VirtualBoard]
) -> float:
    """Time from the sending of a stop until every pin is off [s]; GIVE_UP_S where that did not come."""
    flooder = multiprocessing.get_context("fork").Process(target=flood, daemon=True)
    flooder.start()
    try:
        time.sleep(WARM_UP_S)
        begin = time.monotonic()
        # What counts is when the pins are off, not the answer.
        asking = threading.Thread(target=send, daemon=True)
        asking.start()
        while any(map(_pins_on, boards)) and time.monotonic() - begin < GIVE_UP_S:
            time.sleep(0.01)
        took_s = time.monotonic() - begin
        asking.join(GIVE_UP_S)
        return took_s
    finally:
        flooder.kill()
        flooder.join()


def _send(door: str, words: Any, path: Path, sender: Listener, browser: Client) -> None:
    """Send a stop through a door, in the given wording."""
    if door == "mqtt":
        sender.client.publish(f"{RIG}/set/{words[0]}", words[1], qos=1)
    elif door == "page":
        with contextlib.suppress(requests.RequestException):
            fresh = Client(browser.base)  # a new connection
            fresh.session.cookies.update(browser.session.cookies)
            fresh.post(*words)
    else:
        with contextlib.suppress(OSError), closing(socket.socket(socket.AF_UNIX)) as client:
            client.connect(str(path))  # waits its turn, where one with a time-out would fail at once
            client.settimeout(GIVE_UP_S)
            client.sendall(words + b"\n")
            client.recv(1 << 20)


def _heat(board: VirtualBoard, daemon: DaemonProcess) -> bool:
    """Release all stops, heater and light on (the fan's starts are limited); False where they stay off."""
    deadline = time.monotonic() + GIVE_UP_S
    while not {"heater_relay", "led"} <= set(_pins_on(board)):
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


def _early_end(daemon: DaemonProcess) -> list[str]:
    return [f"the daemon has ended: {daemon.log.strip().splitlines()[-1:]}"] if daemon.has_ended() else []


def _slow(took_s: float) -> list[str]:
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
    client = MqttClient(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    for topic, payload in messages:
        client.publish(f"{RIG}/set/{topic}", payload, qos=0)
        if pause_s:
            time.sleep(pause_s)


if __name__ == "__main__":
    raise SystemExit(main_of(run, 1, 4 * len(FLOODS), "floods", __doc__))
