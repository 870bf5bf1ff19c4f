"""A process of its own that proposes commands: it is asked once a tick over a Unix socket.

PROTOCOL. JSON objects, one a line, UTF-8; the file's permissions are the access control.

    daemon  {"tick": 7, "time_s": ..., "observation": {...}, "features": [...], "reference_c": ...,
             "temp_air_c": ..., "temp_ambient_c": ..., "limits": {...}, "last_sent": {...}, "previous": ...}
    client  {"tick": 7, "heater_duty": 0.35, "fan_on": false}   and, if it likes, "why": any JSON value;
            with any other key the proposal is refused

The daemon asks while the controller `external` decides, and only then. An answer counts until shortly before
the decision's deadline; one to an earlier tick is skipped, it was late. `last_sent` is what the board
confirmed of the step that has just ended, whoever decided it, and `previous` what the client had proposed
for it: null where it had proposed nothing in time.

One client at a time: another one gets {"refused": reason} at the next tick, and is hung up on. So is a client
that sends lines that are too long, that are no JSON, or that reads nothing.

Nothing here runs between ticks and there is no thread: what a client sends meanwhile waits in the kernel's
buffer, which is bounded, and is thrown away before the next question.
"""

import contextlib
import select
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge.core.errors import RequestError
from edge.formats.reader import DocumentError, parse_json
from edge.sockets.client import encode_line
from edge.sockets.unix_socket import listen

LINE_MAX = 65536  # longest answer, and most that may wait between two ticks [bytes]
_CHUNK = 4096


class ExternalProposals:
    """The daemon's side: one question, one answer, within a deadline of wall time."""

    def __init__(self, path: Path) -> None:
        """Errors: ConfigError when the place is taken or can't hold a socket."""
        self._path = path
        self._listener, self._inode = listen(path, "external.socket")
        self._client: socket.socket | None = None

    def ask(self, question: Mapping[str, Any], deadline_s: float) -> dict[str, Any]:
        """Return the client's answer to this tick. Errors: RequestError with the reason for its absence"""
        give_up_s = time.monotonic() + deadline_s
        client = self._present_client()
        if client is None:
            raise RequestError("nobody is connected")
        try:
            _send(client, question, give_up_s)
            return _answer(client, question["tick"], give_up_s)
        except _BrokenClient as broken:
            self._hang_up()
            raise RequestError(str(broken)) from None

    def wait_for_client(self, timeout_s: float) -> bool:
        """Wait for a client before the first tick; return whether one is connected."""
        if self._present_client() is None:
            select.select([self._listener], [], [], timeout_s)
        return self._present_client() is not None

    def close(self) -> None:
        """Hang up and take the file away; can be called twice."""
        self._hang_up()
        self._listener.close()
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()

    def _present_client(self) -> socket.socket | None:
        """Return the present client; further clients are refused."""
        if self._client is not None and not _is_there(self._client):
            self._hang_up()
        while (connection := self._accept()) is not None:
            if self._client is None and _is_there(connection):
                self._client = connection
            else:
                _refuse(connection)
        return self._client

    def _accept(self) -> socket.socket | None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # nobody waits, or the one who did is gone
            return None
        connection.setblocking(False)
        return connection

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


class _BrokenClient(Exception):
    """The client does not keep to the protocol, or is gone."""


def _is_there(client: socket.socket) -> bool:
    """Return whether the client is still connected. Unasked input is discarded, up to a limit."""
    try:
        for _ in range(LINE_MAX // _CHUNK):
            if not client.recv(_CHUNK):
                return False
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False  # it floods


def _refuse(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.send(encode_line({"refused": "another client is connected"}))
    connection.close()


def _send(client: socket.socket, message: Mapping[str, Any], give_up_s: float) -> None:
    unsent = encode_line(message)
    while unsent:
        left_s = give_up_s - time.monotonic()
        if not left_s > 0.0 or not select.select([], [client], [], left_s)[1]:
            raise _BrokenClient("the client does not read")
        try:
            unsent = unsent[client.send(unsent) :]
        except OSError:
            raise _BrokenClient("the client has gone") from None


def _answer(client: socket.socket, tick: int, give_up_s: float) -> dict[str, Any]:
    """Return the first line that answers this tick. Errors: _Broken; RequestError when it comes too late"""
    unread = b""
    while True:
        line, end, rest = unread.partition(b"\n")
        if end:
            unread = rest
            answer = _parse(line)
            if answer.get("tick") == tick:
                return answer
            continue
        if len(unread) > LINE_MAX:
            raise _BrokenClient(f"an answer of more than {LINE_MAX} bytes")
        left_s = give_up_s - time.monotonic()
        if not left_s > 0.0 or not select.select([client], [], [], left_s)[0]:
            raise RequestError(f"no answer to tick {tick} in time")
        unread += _receive(client)


def _receive(client: socket.socket) -> bytes:
    try:
        data = client.recv(_CHUNK)
    except OSError:
        data = b""
    if not data:
        raise _BrokenClient("the client has gone")
    return data


def _parse(line: bytes) -> dict[str, Any]:
    try:
        return parse_json(line, "answer")
    except DocumentError as error:
        raise _BrokenClient(str(error)) from None
