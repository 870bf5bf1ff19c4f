"""Servers that alarms are sent to, in threads: HTTP for ntfy, webhook and signs of life; SMTP for mail."""

import base64
import json
import socket
import socketserver
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from email import message_from_bytes, policy
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


@dataclass
class HttpRequest:
    method: str
    path: str
    headers: dict[str, str]
    body: bytes

    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class HttpSink:
    """An HTTP server that keeps what it hears. status : of its answers; headers : of them, too"""

    url: str = ""
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    heard: list[HttpRequest] = field(default_factory=list)
    port: int = 0

    def texts(self) -> list[str]:
        return [one.body.decode() for one in self.heard]


@contextmanager
def http_sink(port: int = 0, tls: tuple[Path, Path] | None = None) -> Iterator[HttpSink]:
    """Serve at a free port, or at `port`. tls : certificate and key"""
    sink = HttpSink()

    class Handler(BaseHTTPRequestHandler):
        def _hear(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            sink.heard.append(HttpRequest(self.command, self.path, dict(self.headers), body))
            self.send_response(sink.status)
            for name, value in sink.headers.items():
                self.send_header(name, value)
            self.send_header("content-length", "0")
            self.end_headers()

        do_GET = do_POST = do_HEAD = _hear

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingHTTPServer):
        def handle_error(self, *_: object) -> None:
            pass  # a client that hangs up, as one does that does not trust the certificate

    with Server(("127.0.0.1", port), Handler) as server:
        if tls is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(*tls)
            server.socket = context.wrap_socket(
                server.socket, server_side=True, do_handshake_on_connect=False
            )
        sink.port = server.server_address[1]
        sink.url = f"{'https' if tls else 'http'}://127.0.0.1:{sink.port}"
        with _serving(server):
            yield sink


@dataclass
class MailSink:
    """An SMTP server that keeps the mail it takes. users : password by name; refuses : recipients"""

    port: int = 0
    users: dict[str, str] = field(default_factory=dict)
    refuses: set[str] = field(default_factory=set)
    echoes_password: bool = False
    mails: list[EmailMessage] = field(default_factory=list)
    raw: list[bytes] = field(default_factory=list)
    was_encrypted: list[bool] = field(default_factory=list)
    logins: list[str] = field(default_factory=list)


@contextmanager
def mail_sink(tls: tuple[Path, Path] | None = None, starttls: bool = True) -> Iterator[MailSink]:
    """Serve SMTP at a free port. tls : certificate and key; starttls : after the command, else at once"""
    sink = MailSink()
    context = None
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*tls)

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            with suppress(OSError):  # the client hung up
                _SmtpSession(self.request, sink, context, starttls).run()

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Handler) as server:
        sink.port = server.server_address[1]
        with _serving(server):
            yield sink


@contextmanager
def silent_server() -> Iterator[int]:
    """Take connections and say nothing. Yields the port"""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


@contextmanager
def _serving(server: socketserver.BaseServer) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()


class _SmtpSession:
    """One connection: the commands of RFC 5321 that a mail needs, AUTH PLAIN and LOGIN, STARTTLS."""

    def __init__(
        self, line: socket.socket, sink: MailSink, tls: ssl.SSLContext | None, starttls: bool
    ) -> None:
        self.sink, self.tls = sink, tls
        self.is_encrypted = False
        self.offers_starttls = tls is not None and starttls
        self.user = ""
        self.line = line
        if tls is not None and not starttls:
            self._encrypt()
        self.file = self.line.makefile("rwb")

    def run(self) -> None:
        self._say("220 sink ready")
        while command := self.file.readline().decode().strip():
            word, _, rest = command.partition(" ")
            getattr(self, f"do_{word.lower()}", self.do_unknown)(rest)
            if word.upper() == "QUIT":
                return

    def do_ehlo(self, _: str) -> None:
        offers = ["8BITMIME", "AUTH PLAIN LOGIN"] if self.sink.users else ["8BITMIME"]
        if self.offers_starttls and not self.is_encrypted:
            offers.append("STARTTLS")
        lines = ["sink", *offers]
        self._say("\r\n".join(f"250{'-' if line != lines[-1] else ' '}{line}" for line in lines))

    def do_starttls(self, _: str) -> None:
        self._say("220 go ahead")
        self._encrypt()
        self.file = self.line.makefile("rwb")

    def do_auth(self, rest: str) -> None:
        kind, _, first = rest.partition(" ")
        if kind.upper() == "PLAIN":
            _, user, password = base64.b64decode(first).decode().split("\0")
        else:
            user = base64.b64decode(first or self._ask("334 VXNlcm5hbWU6")).decode()
            password = base64.b64decode(self._ask("334 UGFzc3dvcmQ6")).decode()
        self.sink.logins.append(user)
        if self.sink.users.get(user) == password:
            self.user = user
            self._say("235 2.7.0 accepted")
        else:
            echo = f" ({password})" if self.sink.echoes_password else ""
            self._say(f"535 5.7.8 Username and Password not accepted{echo}")

    def do_mail(self, _: str) -> None:
        self._say("530 5.7.0 log in first" if self.sink.users and not self.user else "250 ok")

    def do_rcpt(self, rest: str) -> None:
        refused = any(one in rest for one in self.sink.refuses)
        self._say("550 5.1.1 no such user" if refused else "250 ok")

    def do_data(self, _: str) -> None:
        self._say("354 go on")
        lines = []
        while (line := self.file.readline()) not in (b".\r\n", b""):
            lines.append(line[1:] if line.startswith(b"..") else line)
        raw = b"".join(lines)
        self.sink.raw.append(raw)
        mail = message_from_bytes(raw, policy=policy.default)
        assert isinstance(mail, EmailMessage)
        self.sink.mails.append(mail)
        self.sink.was_encrypted.append(self.is_encrypted)
        self._say("250 taken")

    def do_rset(self, _: str) -> None:
        self._say("250 ok")

    def do_quit(self, _: str) -> None:
        self._say("221 bye")

    def do_unknown(self, _: str) -> None:
        self._say("502 5.5.1 unknown")

    def _encrypt(self) -> None:
        assert self.tls is not None
        self.line = self.tls.wrap_socket(self.line, server_side=True)
        self.is_encrypted = True

    def _ask(self, question: str) -> str:
        self._say(question)
        return self.file.readline().decode().strip()

    def _say(self, text: str) -> None:
        self.file.write(f"{text}\r\n".encode())
        self.file.flush()
