"""One POST to a server that may be slow, endless or hostile: a deadline, a size limit, and an interrupt."""

import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from edge.assistant.llm.failure import LlmFailure


class Interrupt:
    """Fired once, for good. Sockets that are held here are shut down, so that no read outlasts it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fired = threading.Event()
        self._sockets: list[socket.socket] = []

    @property
    def fired(self) -> bool:
        """True when the work must end."""
        return self._fired.is_set()

    def fire(self) -> None:
        """From any thread."""
        with self._lock:
            self._fired.set()
            for held in self._sockets:
                with suppress(OSError):  # not connected any more
                    held.shutdown(socket.SHUT_RDWR)

    def hold(self, connection: socket.socket) -> None:
        """Shut `connection` down when fired; a second descriptor of it is kept, which TLS does not wrap."""
        with self._lock:
            self._sockets.append(connection.dup())
        if self.fired:
            self.fire()

    def wait(self, seconds: float) -> bool:
        """Pause; return True early when interrupted."""
        return self._fired.wait(seconds)

    def let_go(self) -> None:
        """Close what was held."""
        with self._lock:
            for held in self._sockets:
                held.close()
            self._sockets.clear()


SIZE_MAX = 1 << 20  # of a reply [bytes]
PIECE = 1 << 14


@dataclass(frozen=True, slots=True)
class HttpResponse:
    """Status, the one header that matters, the body."""

    status: int
    retry_after: str
    raw: bytes


Post = Callable[[str, bytes, Mapping[str, str], float, Interrupt], HttpResponse]


def post(
    url: str, body: bytes, headers: Mapping[str, str], deadline_s: float, stop: Interrupt, ca: str = ""
) -> HttpResponse:
    """Send, and read all of the reply within `deadline_s`, however slowly its bytes drip.

    ca : file of the authority that signs an https server's certificate; empty: those of certifi

    A timeout of the socket would start anew at every byte, so a timer shuts the connection down.
    Errors : LlmFailure: unreachable, timeout, interrupted, malformed (too long)
    """
    import requests  # late: with its friends it is 5 MB, and most rigs have no language model
    import urllib3

    # Two interrupts: this request's deadline, and the owner's stop, which outlives it.
    own = Interrupt()
    timer = threading.Timer(deadline_s, own.fire)
    timer.daemon = True
    timer.start()
    try:
        with _session((own, stop), ca) as session:
            with session.post(
                url,
                data=body,
                headers={**headers, "Accept-Encoding": "identity"},
                timeout=deadline_s,
                stream=True,
                allow_redirects=False,  # the key is for this server
            ) as response:
                raw = _read(response.raw)
            return HttpResponse(response.status_code, response.headers.get("Retry-After", ""), raw)
    except (requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError) as error:
        raise _failure(error, own, stop, deadline_s) from None
    finally:
        timer.cancel()
        own.let_go()
        stop.let_go()


def _failure(error: Exception, own: Interrupt, stop: Interrupt, deadline_s: float) -> LlmFailure:
    """Return the failure by the exception's kind alone: its text may hold the URL and any secret in it."""
    import requests

    if stop.fired:
        return LlmFailure("interrupted", "nobody waits for the answer any more")
    if own.fired or isinstance(error, requests.ReadTimeout):
        return LlmFailure("timeout", f"no whole reply within {deadline_s:.3g} s")
    return LlmFailure("unreachable", f"the line failed: {type(error).__name__}")


def _read(raw: Any) -> bytes:
    """Errors: LlmFailure, malformed, of a reply without an end."""
    pieces, size = [], 0
    for piece in raw.stream(PIECE, decode_content=False):
        size += len(piece)
        if size > SIZE_MAX:
            raise LlmFailure("malformed", f"the reply is longer than {SIZE_MAX} bytes")
        pieces.append(piece)
    return b"".join(pieces)


def _session(interrupts: tuple[Interrupt, ...], ca: str) -> Any:
    """Return a session whose connections can be interrupted. Proxies and
    .netrc of the environment are not used.
    """
    import requests
    from requests.adapters import HTTPAdapter
    from urllib3.connection import HTTPConnection, HTTPSConnection
    from urllib3.connectionpool import HTTPConnectionPool, HTTPSConnectionPool

    def hold(connection: socket.socket) -> socket.socket:
        for interrupt in interrupts:
            interrupt.hold(connection)
        return connection

    class Plain(HTTPConnection):
        def _new_conn(self) -> socket.socket:  # before TLS begins: a handshake can drip too
            return hold(super()._new_conn())

    class Tls(HTTPSConnection):
        def _new_conn(self) -> socket.socket:
            return hold(super()._new_conn())

    class PlainPool(HTTPConnectionPool):
        ConnectionCls = Plain

    class TlsPool(HTTPSConnectionPool):
        ConnectionCls = Tls

    session = requests.Session()
    session.trust_env = False
    session.verify = ca or True
    # No retries in the library: they would not know of the deadline.
    for scheme, pool in (("http", PlainPool), ("https", TlsPool)):
        adapter = HTTPAdapter(pool_maxsize=1, max_retries=0)
        adapter.poolmanager.pool_classes_by_scheme = {scheme: pool}
        session.mount(f"{scheme}://", adapter)
    return session
