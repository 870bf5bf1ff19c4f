"""Serves the page: to this machine alone until `greenhouse page pair`, then to the network."""

import asyncio
import contextlib
import ctypes
import socket
from collections.abc import Iterator
from functools import partial

import uvicorn

from edge.config.settings import PageSettings, Settings
from edge.core.errors import ConfigError
from edge.page.access import Access
from edge.page.app import make_app
from edge.page.certificate import check_certificate
from edge.page.guard import Guard
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
    prepare()
    access = Access.of(settings.page.folder)
    while True:
        opened = bool(settings.page.host) or access.is_open_to_network
        if asyncio.run(_serve(settings, file, access, opened)):
            return


def prepare() -> None:
    """Make this process one that serves, before any connection.

    The allocator returns large blocks: else each thread keeps the 16 MB of a password's scrypt.
    """
    limit_connections()
    with contextlib.suppress(AttributeError):  # another C library than glibc
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BLOCK)


async def _serve(settings: Settings, file: str, access: Access, opened: bool) -> bool:
    """Serve until the end, or until the network is allowed; return whether it is the end."""
    server = uvicorn.Server(config_of(make_app(settings, file), settings.page))
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(each) for each in listen(settings.page, opened)]
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


def config_of(app: Guard, page: PageSettings) -> uvicorn.Config:
    """Return how an application is served. Errors: ConfigError for a bad certificate"""
    check_certificate(page)
    return uvicorn.Config(
        app,
        http=partial(ImpatientProtocol, proxies=page.proxies),  # type: ignore[arg-type]
        loop="asyncio",
        ws="none",
        log_level="error",  # a warning for each broken request would let strangers wear the card
        access_log=False,
        server_header=False,
        proxy_headers=bool(page.proxies),
        forwarded_allow_ips=list(page.proxies),
        limit_concurrency=CONNECTIONS_MAX + BACKLOG,  # the protocol makes room before
        backlog=BACKLOG,
        h11_max_incomplete_event_size=HEAD_MAX,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=CLOSING_MAX_S,
        ssl_certfile=page.certificate or None,
        ssl_keyfile=page.key_file or None,
    )


def listen(page: PageSettings, opened: bool) -> Iterator[socket.socket]:
    """Yield the sockets to listen at. Errors: ConfigError

    opened : to the network, where the settings name no address
    """
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
