"""An OpenAI-compatible HTTP server on the loopback, with a script behind it."""

import json
import math
import ssl
import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

from edge.formats.reader import DocumentError, parse_json
from training.llm_stand_in import MODEL
from training.llm_stand_in.behaviours import BEHAVIOURS, Sending

KEPT = 2000  # requests that are kept for whoever wants to see what was asked


class StandIn:
    """`with StandIn("429") as stand_in:`; its `requests` are the bodies that it was sent.

    behave : a key of BEHAVIOURS; may be changed while it serves; tls : its certificate, None for plain HTTP
    """

    def __init__(
        self, behave: str = "honest", seed: int = 0, port: int = 0, tls: ssl.SSLContext | None = None
    ) -> None:
        self.behave = behave
        self.seed = seed
        self.requests: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.closing = threading.Event()
        self._server = _Server(("127.0.0.1", port), self)
        self._scheme = "http" if tls is None else "https"
        if tls is not None:
            self._server.socket = tls.wrap_socket(self._server.socket, server_side=True)
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, name="stand-in", daemon=True
        )

    @property
    def url(self) -> str:
        """The base URL, as `llm.url` has it."""
        return f"{self._scheme}://127.0.0.1:{self._server.server_address[1]}/v1"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def sending(self, body: dict[str, Any]) -> Sending:
        """Return the response to this request."""
        return BEHAVIOURS[self.behave](body, self.seed)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, address: tuple[str, int], stand_in: StandIn) -> None:
        super().__init__(address, _Handler)
        self.stand_in = stand_in

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that hangs up."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        if self.path == "/v1/models":
            models = {"object": "list", "data": [{"id": MODEL, "object": "model", "owned_by": "tests"}]}
            self._send(Sending(json.dumps(models).encode()))
        else:
            self._send(Sending(b"{}", 404))

    def do_POST(self) -> None:
        raw = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.path != "/v1/chat/completions":
            self._send(Sending(b"{}", 404))
            return
        try:
            body = parse_json(raw)
        except DocumentError:
            self._send(Sending(b'{"error": {"message": "no JSON"}}', 400))
            return
        stand_in = self.server.stand_in
        if len(stand_in.requests) < KEPT:
            stand_in.requests.append(body)
            stand_in.headers.append(dict(self.headers))
        self._send(stand_in.sending(body))

    def _send(self, what: Sending) -> None:
        closing = self.server.stand_in.closing
        if what.after_s > 0.0 and closing.wait(None if math.isinf(what.after_s) else what.after_s):
            return
        with suppress(OSError):  # the client has gone
            self.send_response(what.status)
            for name, value in what.headers.items():
                self.send_header(name, value)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(what.raw)))
            self.end_headers()
            self._write(what, closing)

    def _write(self, what: Sending, closing: threading.Event) -> None:
        raw = what.raw[: len(what.raw) // 2] if what.cut else what.raw
        if not what.drip_s:
            self.wfile.write(raw)
            return
        for place in range(len(raw)):
            self.wfile.write(raw[place : place + 1])
            if closing.wait(what.drip_s):
                return

    def log_message(self, format: str, *arguments: Any) -> None:
        """Quiet."""
