"""Serves the page: to this machine alone until `greenhouse page pair`, then to the network."""

import asyncio
import contextlib
import ctypes
import socket
from collections.abc import Iterator

import uvicorn

from edge.config.settings import Settings
from edge.core.errors import ConfigError
from edge.page.access import Access
from edge.page.app import make_app
from edge.page.certificate import check_certificate
from edge.page.protocol import BACKLOG, CONNECTIONS_MAX, HEAD_MAX, ImpatientProtocol, limit_connections

LOCAL = "127.0.0.1"
KEEP_ALIVE_S = 15
CLOSING_MAX_S = 2
UNREAD_MAX_MS = 20_000  # after which who reads nothing of an answer, or has left the network, is hung up on
M_MMAP_THRESHOLD = -3  # malloc.h; a value that is set does not grow any more
LARGE_BLOCK = 1 << 20  # bytes
LOOK_S = 1.0  # between two looks whether the network is allowed


def serve(settings: Settings, file: str = "") -> None:
    """Serve until SIGTERM or SIGINT. Errors: ConfigError where the address is taken or the certificate bad

    file : of the settings, "" for every default
    """
    _give_memory_back()
    limit_connections()
    access = Access.of(settings.page.folder)
    while True:
        opened = bool(settings.page.host) or access.is_open_to_network
        if asyncio.run(_serve(settings, file, access, opened)):
            return


def _give_memory_back() -> None:
    """Let the allocator return large blocks: else each thread keeps the 16 MB of a password's scrypt."""
    with contextlib.suppress(AttributeError):  # another C library than glibc
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BLOCK)


async def _serve(settings: Settings, file: str, access: Access, opened: bool) -> bool:
    """Serve until the end, or until the network is allowed; return whether it is the end."""
    server = uvicorn.Server(_config(settings, file))
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(each) for each in _listen(settings, opened)]
        watching = asyncio.create_task(_watch(server, access, opened))
        await server.serve(sockets=sockets)
        if not watching.done():
            watching.cancel()
            return True
        return False


async def _watch(server: uvicorn.Server, access: Access, opened: bool) -> None:
    """End the server when the network was not allowed and is now."""
    while opened or not access.is_open_to_network:
        await asyncio.sleep(LOOK_S)
    server.should_exit = True


def _config(settings: Settings, file: str) -> uvicorn.Config:
    page = settings.page
    check_certificate(page)
    return uvicorn.Config(
        make_app(settings, file),
        http=ImpatientProtocol,
        loop="asyncio",
        ws="none",
        log_level="error",  # a warning for each broken request would let strangers wear the card
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS_MAX,
        backlog=BACKLOG,
        h11_max_incomplete_event_size=HEAD_MAX,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=CLOSING_MAX_S,
        ssl_certfile=page.certificate or None,
        ssl_keyfile=page.key_file or None,
    )


def _listen(settings: Settings, opened: bool) -> Iterator[socket.socket]:
    """Yield the sockets to listen at. Errors: ConfigError"""
    page = settings.page
    hosts = (page.host,) if page.host else ("::",) if opened and socket.has_dualstack_ipv6() else ("",)
    if not page.host and not opened:
        hosts = (LOCAL,)
    for host in hosts:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        place = (host, page.port)
        try:
            listener = socket.create_server(
                place, family=family, dualstack_ipv6=host == "::", backlog=BACKLOG
            )
        except OSError as error:
            raise ConfigError(f"page.host, page.port: {host or '*'}:{page.port}: {error.strerror}") from error
        # Each connection takes both over. Else the body of an answer waits 40 ms for news of its head.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNREAD_MAX_MS)
        yield listener
