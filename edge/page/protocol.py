"""HTTP/1.1 that keeps no place for who only holds it: slow requests, unread answers, too many connections.

A connection takes 20 to 130 kB while it waits, over https 256 kB more by asyncio's choice. If all
places are in use, a new connection replaces the one silent longest, first of the address that has most.
"""

import asyncio
import ipaddress
from asyncio import constants, sslproto
from collections import Counter
from collections.abc import Iterable
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS_MAX = 300
BACKLOG = 100  # that asyncio takes in at once, before any is counted
READ_MAX = HEAD_MAX = 16 << 10  # bytes; a browser's head has one or two thousand
HEAD_MAX_S = 10.0  # for the head of a request, from its first byte or the beginning of the connection
NETWORK_BITS = 64  # of an IPv6 address, which one machine can change as it likes below


class _EarlyTls(sslproto.SSLProtocol):
    """Shows a connection to its protocol before the handshake, which a silent client never makes."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        if isinstance(self._app_protocol, ImpatientProtocol):
            self._app_protocol.line = transport
        super().connection_made(transport)


def limit_connections() -> None:
    """Have asyncio take no more memory and time for a connection over https than for another one."""
    sslproto.SSLProtocol = _EarlyTls  # type: ignore[misc]
    sslproto.SSLProtocol.max_size = READ_MAX
    constants.SSL_HANDSHAKE_TIMEOUT = HEAD_MAX_S


class ImpatientProtocol(H11Protocol):
    """One connection. Uvicorn alone waits without end for a request that has begun.

    proxies : addresses of proxies, whose connections count for the address that they name
    """

    _all: ClassVar[dict["ImpatientProtocol", None]] = {}  # the longest silent one first
    _deadline: asyncio.TimerHandle | None = None
    line: asyncio.Transport | None = None  # below TLS, where there is any
    address = ""

    def __init__(self, *words: Any, proxies: Iterable[str] = (), **options: Any) -> None:
        super().__init__(*words, **options)
        self._proxies = frozenset(proxies)
        # Here and not in `connection_made`, which over https comes after the handshake.
        if len(self._all) >= CONNECTIONS_MAX:
            self._make_room()
        self._all[self] = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection."""
        super().connection_made(transport)
        self.line = self.line or transport
        self.address = _network(self.client[0] if self.client else "")
        transport.max_size = READ_MAX  # type: ignore[attr-defined]
        self._look()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        if self in self._all:
            del self._all[self]
            self._all[self] = None
        super().data_received(data)
        if self.headers and self.client and self.client[0] in self._proxies:
            named = dict(self.headers).get(b"x-forwarded-for", b"").decode("latin-1")
            self.address = _network(named.rpartition(",")[2].strip()) or self.address
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the connection."""
        self._all.pop(self, None)
        self._forget()
        super().connection_lost(exc)

    def timeout_keep_alive_handler(self) -> None:
        """Hang up some time after the last answer, also where that is still unread."""
        self.transport.abort()

    def _make_room(self) -> None:
        for gone in [one for one in self._all if one.line is not None and one.line.is_closing()]:
            del self._all[gone]  # its handshake has failed, so nothing else reports its loss
        if len(self._all) < CONNECTIONS_MAX:
            return
        shares = Counter(one.address for one in self._all)
        reached = [one for one in self._all if one.line is not None]
        leaves = min(reached, key=lambda one: (one._patience, -shares[one.address]), default=None)
        if leaves is not None and leaves.line is not None:
            del self._all[leaves]
            leaves.line.abort()

    @property
    def _patience(self) -> int:
        """The right to stay: 0 without a request, 1 while the body of one is awaited, 2 within an answer."""
        if self.cycle is None or self.cycle.response_complete:
            return 0
        return 2 if self.cycle.response_started else 1

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


def _network(address: str) -> str:
    """Return what counts as one client: an address, or a network of IPv6; "" for an invalid address."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return ""
    if isinstance(found, ipaddress.IPv4Address) or found.ipv4_mapped:
        return str(getattr(found, "ipv4_mapped", None) or found)
    return str(ipaddress.ip_network((found, NETWORK_BITS), strict=False))
