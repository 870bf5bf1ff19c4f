"""The command line's way into the running daemon: JSON lines on a Unix socket.

One request object a line, one answer object a line, in order. The file's permissions are the access control.
"""

import contextlib
import json
import selectors
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from edge.errors import RequestError
from edge.strict_json import parse_object
from edge.unix_socket import listen

Ask = Callable[[Mapping[str, Any]], dict[str, Any]]

LINE_MAX = 65536  # longest request [bytes]
CLIENTS_MAX = 32


class NobodyListens(RequestError):
    """There is no daemon to ask."""


class _Client:
    """One connection and what is under way on it.

    A line is answered only when the answer before it is gone, and no more is read meanwhile: a client that
    does not read its answers holds up itself alone, in bounded memory.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.unread = b""
        self.unsent = b""
        self.ended = False  # nothing more comes, or nothing more is wanted

    @property
    def is_busy(self) -> bool:
        """There is a line to answer or an answer to send."""
        return bool(self.unsent) or b"\n" in self.unread

    def receive(self) -> None:
        data = self.connection.recv(LINE_MAX)
        self.ended = not data
        self.unread += data
        if len(self.unread) > LINE_MAX and b"\n" not in self.unread:
            self.refuse(f"request is longer than {LINE_MAX} bytes")

    def take_line(self) -> bytes | None:
        line, end, rest = self.unread.partition(b"\n")
        if self.unsent or not end:
            return None
        self.unread = rest
        return line

    def refuse(self, reason: str) -> None:
        self.unread, self.unsent, self.ended = b"", _line(_error(reason)), True

    def send(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self.unsent:
                self.unsent = self.unsent[self.connection.send(self.unsent) :]


class ControlSocket:
    """Server side, in a thread of its own.

    ask : gives a request to the control thread and waits for the answer, with a time limit of its own
    Errors : ConfigError when the place is taken by a running daemon or can't hold a socket
    """

    def __init__(self, path: Path, ask: Ask) -> None:
        self._path, self._ask = path, ask
        self._listener, self._inode = listen(path, "control_socket.path")
        self._wake, self._ring = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._clients: dict[socket.socket, _Client] = {}
        self._thread = threading.Thread(target=self._run, name="control-socket", daemon=True)
        self._thread.start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Take the file away and end the thread; one that waits for an answer is left to its time limit."""
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()
        self._ring.close()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            for key, events in self._selector.select():
                if key.fileobj is self._wake:
                    return self._shut_down()
                if key.fileobj is self._listener:
                    self._accept()
                else:
                    self._serve(key.data, events)

    def _shut_down(self) -> None:
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        self._listener.close()
        self._wake.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return  # the client is gone again, or we are out of descriptors until another one leaves
        connection.setblocking(False)
        client = self._clients[connection] = _Client(connection)
        self._selector.register(connection, selectors.EVENT_READ, client)
        if len(self._clients) > CLIENTS_MAX:
            client.refuse("too many clients")
            self._serve(client, 0)

    def _serve(self, client: _Client, events: int) -> None:
        """One line at most, so that clients take turns."""
        try:
            if events & selectors.EVENT_READ:
                client.receive()
            line = client.take_line()
            if line is not None:
                client.unsent = _line(self._answer(line))
            client.send()
        except OSError:
            self._drop(client)
            return
        if client.ended and not client.is_busy:
            self._drop(client)
        else:
            wanted = selectors.EVENT_WRITE if client.is_busy else selectors.EVENT_READ
            self._selector.modify(client.connection, wanted, client)

    def _answer(self, line: bytes) -> dict[str, Any]:
        if len(line) > LINE_MAX:
            return _error(f"request is longer than {LINE_MAX} bytes")
        try:
            request = parse_object(line)
        except ValueError as error:
            return _error(f"request: {error}")
        try:
            return self._ask(request)
        except Exception as error:  # told and gone on: a bug must not close the way to the emergency stop
            return _error(f"internal error: {error!r}")

    def _drop(self, client: _Client) -> None:
        self._selector.unregister(client.connection)
        client.connection.close()
        del self._clients[client.connection]


def request(path: Path, message: Mapping[str, Any], timeout_s: float = 15.0) -> dict[str, Any]:
    """Client side: send one request, wait for its answer. Errors: RequestError, of it NobodyListens."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            connection.sendall(_line(message))
            with connection.makefile("rb") as answers:
                answer = answers.readline()
    except (FileNotFoundError, ConnectionRefusedError):
        raise NobodyListens(f"no daemon listens at {path}") from None
    except TimeoutError:
        raise RequestError(f"the daemon at {path} did not answer within {timeout_s:g} s") from None
    except OSError as error:
        raise RequestError(f"{path}: {error.strerror or error}") from None
    if not answer.endswith(b"\n"):
        raise RequestError(f"the daemon at {path} went away before it answered")
    return parse_object(answer)


def _line(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _error(text: str) -> dict[str, Any]:
    return {"ok": False, "error": text}
