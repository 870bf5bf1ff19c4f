"""Serves the page: to this machine alone until `greenhouse page pair`, then to the network."""

import asyncio
import contextlib
import ctypes
import socket
import ssl
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import uvicorn

from edge.config.settings import PageSettings, Settings
from edge.core.errors import ConfigError
from edge.formats.input_file import read_file
from edge.page.access import Access
from edge.page.app import make_app
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


EXPIRED = 10  # X509_V_ERR_CERT_HAS_EXPIRED, openssl/x509_vfy.h


def check_certificate(page: PageSettings) -> None:
    """Refuse files that no browser can be served with; no certificate is fine. Errors: ConfigError

    A certificate that is not valid yet passes: after a power cut the clock of a small computer may be behind.
    """
    if not page.certificate:
        return
    for setting, file in (("certificate", page.certificate), ("key_file", page.key_file)):
        try:
            read_file(Path(file))
        except OSError as error:
            raise ConfigError(f"page.{setting}: {file}: {error.strerror}") from error
    _check_dates(_client_of(page), _server_of(page), page.certificate)


def _client_of(page: PageSettings) -> ssl.SSLContext:
    """Return the side that trusts this certificate and no other one."""
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # its issuer need not be in the file
    try:
        client.load_verify_locations(page.certificate)
    except ssl.SSLError as error:
        raise ConfigError(f"page.certificate: {page.certificate}: not a certificate in PEM") from error
    return client


def _server_of(page: PageSettings) -> ssl.SSLContext:
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        server.load_cert_chain(page.certificate, page.key_file, password="")  # else OpenSSL asks a terminal
    except ssl.SSLError as error:
        fault = (
            f"not the key of {page.certificate}"
            if error.reason == "KEY_VALUES_MISMATCH"
            else "not a key in PEM without a password"
        )
        raise ConfigError(f"page.key_file: {page.key_file}: {fault}") from error
    return server


def _check_dates(client: ssl.SSLContext, server: ssl.SSLContext, certificate: str) -> None:
    """Let the two shake hands in memory: the standard library reads no dates out of a certificate."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (client.wrap_bio(to_client, to_server), server.wrap_bio(to_server, to_client, server_side=True))
    for end in (*ends, *ends):
        try:
            end.do_handshake()
        except ssl.SSLWantReadError:
            continue
        except ssl.SSLCertVerificationError as error:
            if error.verify_code == EXPIRED:
                raise ConfigError(f"page.certificate: {certificate}: it has expired") from error
            return
