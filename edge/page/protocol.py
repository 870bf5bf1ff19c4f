"""HTTP/1.1 that keeps no place for who only holds it: slow requests, unread answers, too many connections.

A connection takes 20 to 130 kB while it waits, over https 256 kB more by asyncio's own choice.
"""

import asyncio
import os
from asyncio import constants, sslproto
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS_MAX = 300
BACKLOG = 100  # that asyncio takes in at once, before any is counted
OTHER_FILES = 30  # that the page has open beside connections
READ_MAX = HEAD_MAX = 16 << 10  # bytes; a browser's head has one or two thousand
HEAD_MAX_S = 10.0  # for the head of a request, from its first byte or the beginning of the connection


def limit_connections() -> None:
    """Have asyncio take no more memory and time for a connection over https than for another one."""
    sslproto.SSLProtocol.max_size = READ_MAX
    constants.SSL_HANDSHAKE_TIMEOUT = HEAD_MAX_S


class ImpatientProtocol(H11Protocol):
    """One connection. Uvicorn alone waits without end for a request that has begun.

    Errors : ConnectionRefusedError for one too many, which has asyncio close it
    """

    _deadline: asyncio.TimerHandle | None = None

    def __init__(self, *words: Any, **options: Any) -> None:
        # Here and not in `connection_made`, which over https comes after the handshake.
        if _open_files() > CONNECTIONS_MAX + OTHER_FILES:
            raise ConnectionRefusedError(f"{CONNECTIONS_MAX} connections are open")
        super().__init__(*words, **options)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection."""
        super().connection_made(transport)
        transport.max_size = READ_MAX  # type: ignore[attr-defined]
        self._look()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        super().data_received(data)
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the connection."""
        self._forget()
        super().connection_lost(exc)

    def timeout_keep_alive_handler(self) -> None:
        """Hang up some time after the last answer, also where that is still unread."""
        self.transport.abort()

    def _look(self) -> None:
        """Set the deadline of a request that is not being answered yet; further bytes do not move it."""
        if self.cycle is not None and not self.cycle.response_complete:
            self._forget()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_MAX_S, self.transport.abort)

    def _forget(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _open_files() -> int:
    with os.scandir("/proc/self/fd") as files:
        return sum(1 for _ in files)
