"""The control socket: one JSON object a line, answered by one line. It is no part of the wire protocol."""

import json
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Handler = Callable[[Mapping[str, Any], "ControlClient"], Mapping[str, Any]]

_LONGEST_LINE = 65536


class ControlRequestError(Exception):
    """A request that can't be carried out; its text goes back as {"error": text}."""


class ControlClient:
    """One connection and the bytes of a line not yet whole."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self._rest = b""

    def lines(self) -> list[bytes] | None:
        """Whole lines that have arrived; None when the other side has gone."""
        try:
            data = self.connection.recv(_LONGEST_LINE)
        except OSError:
            return None
        *lines, self._rest = (self._rest + data).split(b"\n")
        return lines if data and len(self._rest) < _LONGEST_LINE else None

    def answer(self, reply: Mapping[str, Any]) -> None:
        """Send one line; a client that has gone misses it."""
        try:
            self.connection.sendall(json.dumps(reply).encode() + b"\n")
        except OSError:
            return


class BoardControlSocket:
    """Listens on a Unix socket that only its owner can use, and serves those that connect."""

    def __init__(self, path: Path, handler: Handler) -> None:
        self._path = path
        self._handler = handler
        self._clients: dict[socket.socket, ControlClient] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        path.chmod(0o600)
        self._listener.listen()

    @property
    def sockets(self) -> list[socket.socket]:
        """All to wait on."""
        return [self._listener, *self._clients]

    def serve(self, ready: socket.socket) -> None:
        """Do what a readable socket asks for."""
        if ready is self._listener:
            connection, _ = self._listener.accept()
            self._clients[connection] = ControlClient(connection)
            return
        client = self._clients[ready]
        lines = client.lines()
        if lines is None:
            del self._clients[ready]
            ready.close()
            return
        for line in lines:
            client.answer(self._reply(line, client))

    def _reply(self, line: bytes, client: ControlClient) -> Mapping[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"error": f"not JSON: {error}"}
        if not isinstance(request, dict):
            return {"error": "a request is a JSON object"}
        try:
            return self._handler(request, client)
        except ControlRequestError as error:
            return {"error": str(error)}

    def close(self) -> None:
        """Hang up on everybody and remove the socket."""
        for connection in self.sockets:
            connection.close()
        self._path.unlink(missing_ok=True)
