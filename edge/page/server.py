"""Serves the page: to this machine alone until `greenhouse page pair`, then to the network."""

import asyncio
import contextlib
import socket
from collections.abc import Iterator

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from edge.config.settings import Settings
from edge.core.errors import ConfigError
from edge.page.access import Access
from edge.page.app import make_app
from edge.page.certificate import check_certificate

LOCAL = "127.0.0.1"
CONNECTIONS_MAX = 300
HEAD_MAX_S = 10.0  # for the first request's head on a new connection
KEEP_ALIVE_S = 15
CLOSING_MAX_S = 2
LOOK_S = 1.0  # between two looks whether the network is allowed


class ImpatientProtocol(H11Protocol):
    """HTTP/1.1 that hangs up on a connection whose first request does not come."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection."""
        super().connection_made(transport)
        self.loop.call_later(HEAD_MAX_S, self._hang_up_if_silent)

    def _hang_up_if_silent(self) -> None:
        if self.cycle is None and not self.transport.is_closing():
            self.transport.close()


def serve(settings: Settings) -> None:
    """Serve until SIGTERM or SIGINT. Errors: ConfigError where the address is taken or the certificate bad"""
    access = Access.of(settings.page.folder)
    while True:
        opened = bool(settings.page.host) or access.is_open_to_network
        if asyncio.run(_serve(settings, access, opened)):
            return


async def _serve(settings: Settings, access: Access, opened: bool) -> bool:
    """Serve until the end, or until the network is allowed; return whether it is the end."""
    server = uvicorn.Server(_config(settings))
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


def _config(settings: Settings) -> uvicorn.Config:
    page = settings.page
    check_certificate(page)
    return uvicorn.Config(
        make_app(settings),
        http=ImpatientProtocol,
        loop="asyncio",
        ws="none",
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS_MAX,
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
        try:
            if host == "::":
                yield socket.create_server((host, page.port), family=family, dualstack_ipv6=True, backlog=100)
            else:
                yield socket.create_server((host, page.port), family=family, backlog=100)
        except OSError as error:
            raise ConfigError(f"page.host, page.port: {host or '*'}:{page.port}: {error.strerror}") from error
