"""One exchange with a server elsewhere: its socket, its end from outside, and in words why it failed."""

import http.client
import socket
import ssl
from collections.abc import Mapping
from contextlib import closing, suppress
from http import HTTPStatus
from urllib.parse import SplitResult, quote, urlsplit

from edge.config.alarm_settings import HttpTarget
from edge.config.secrets import read_secret
from edge.core.errors import ConfigError, GreenhouseError
from edge.core.plain_text import plain
from edge.core.version import __version__
from edge.formats.address import url_problem

WAIT_MAX_S = 10.0  # for a connection, and for each part of an answer
PATH_SAFE = "/%:=&?~+!$,;'@()*[]"  # of a URL's path and query, as they may stand in a request


class SendError(GreenhouseError):
    """A message that did not arrive; the text says why, without any secret.

    lasting : the server has refused it, so that a try soon after is of no use
    """

    def __init__(self, reason: str, lasting: bool = False) -> None:
        super().__init__(reason)
        self.lasting = lasting


class Cut:
    """Ends an exchange from another thread: its socket is shut, and whoever waits for it fails at once."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._is_cut = False

    def watch(self, opened: socket.socket) -> None:
        """Take the socket of the exchange, or the one that has taken its place."""
        self._socket = opened
        if self._is_cut:
            self()

    def __call__(self) -> None:
        """Shut it, if it is open."""
        self._is_cut = True
        if self._socket is not None:
            with suppress(OSError):  # it is closed already
                socket.socket.shutdown(self._socket, socket.SHUT_RDWR)  # not TLS's, which is not thread-safe


def connect(host: str, port: int, tls: ssl.SSLContext | None, cut: Cut) -> socket.socket:
    """Return an open connection. tls : None for an open line. Errors: OSError"""
    opened = socket.create_connection((host, port), WAIT_MAX_S)
    cut.watch(opened)
    if tls is None:
        return opened
    try:
        wrapped = tls.wrap_socket(opened, server_hostname=host, do_handshake_on_connect=False)
    except BaseException:
        opened.close()
        raise
    cut.watch(wrapped)
    try:
        wrapped.do_handshake()
    except BaseException:
        wrapped.close()
        raise
    return wrapped


def tls_of(ca: str, setting: str) -> ssl.SSLContext:
    """Return the check of servers' certificates. ca : PEM file, "" for the system's. Errors: SendError"""
    try:
        return ssl.create_default_context(cafile=ca or None)
    except OSError as error:
        raise SendError(f"{setting}: {ca}: {error.strerror or error}", lasting=True) from None


def reason_of(error: Exception, host: str) -> str:
    """Return in words why an exchange with `host` failed."""
    match error:
        case ssl.SSLCertVerificationError():
            return f"{host}: its certificate is not trusted: {error.verify_message}"
        case ssl.SSLError():
            return f"{host}: TLS failed: {plain(str(error.reason or error))}"
        case socket.gaierror():
            return f"{host}: this name is not found ({error.strerror}); is the network there?"
        case TimeoutError():
            return f"{host}: no answer within {WAIT_MAX_S:g} s"
        case OSError():
            return f"{host}: {plain(str(error.strerror or error))}"
    return f"{host}: it closed the connection, or its answer cannot be read ({type(error).__name__})"


def secret(name: str, setting: str) -> str:
    """Return the line in a secret file, "" for none. Errors: SendError

    Read for each message: who corrects a password need not restart the page.
    """
    try:
        found = read_secret(name, setting).value if name else ""
    except ConfigError as error:
        raise SendError(str(error), lasting=True) from None
    if not found.isprintable():  # in a header, a line end would begin another one
        raise SendError(
            f"{setting}: has more than one line, or characters that are not printable", lasting=True
        )
    return found


def url_of(target: HttpTarget, setting: str) -> SplitResult:
    """Return the address of a target. Errors: SendError, which does not quote it"""
    url = (target.url or secret(target.url_file, f"{setting}.url_file")).strip()
    if url_problem(url):
        key = f"{setting}.url" if target.url else f"{setting}.url_file"
        raise SendError(f"{key}: is not an address such as https://host/path", lasting=True)
    return urlsplit(url)


def ask(
    target: HttpTarget, setting: str, cut: Cut, method: str, body: bytes | None, headers: Mapping[str, str]
) -> None:
    """Send one HTTP request and see that it is taken. Errors: SendError

    A redirect is not followed: it would carry text and token to a place that nobody has configured.
    """
    url = url_of(target, setting)
    host = str(url.hostname)
    is_tls = url.scheme == "https"
    path = quote(url.path or "/", PATH_SAFE) + (f"?{quote(url.query, PATH_SAFE)}" if url.query else "")
    context = tls_of(target.ca, f"{setting}.ca") if is_tls else None
    port = url.port or (443 if is_tls else 80)
    line = http.client.HTTPConnection(host, port, timeout=WAIT_MAX_S)
    line.default_port = 443 if is_tls else 80  # so that the header Host is the usual one
    try:
        with closing(line):
            line.sock = connect(host, port, context, cut)
            line.request(method, path, body, {"User-Agent": f"greenhouse/{__version__}", **headers})
            status = line.getresponse().status
    except (OSError, http.client.HTTPException, UnicodeError) as error:
        raise SendError(reason_of(error, host)) from None
    _check(status, host)


def _check(status: int, host: str) -> None:
    """Refuse what is not a success. Errors: SendError, without the server's words: secrets may be in them"""
    if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
        return
    phrase = next((known.phrase for known in HTTPStatus if known == status), "")
    told = f"{host} answers {status} {phrase}".rstrip()
    if status < HTTPStatus.BAD_REQUEST:
        raise SendError(f"{told}: a redirect, which is not followed; set the final address", lasting=True)
    is_busy = status == HTTPStatus.TOO_MANY_REQUESTS or status >= HTTPStatus.INTERNAL_SERVER_ERROR
    raise SendError(told, lasting=not is_busy)
