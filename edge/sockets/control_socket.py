"""The command line's way into the running daemon: JSON lines on a Unix socket.

One request object a line, one answer object a line, in order. The file's permissions are the access control.

One thread reads and writes and never waits for an answer. Emergency stop and maintenance go from there
straight to the control thread; all other requests are asked one after the other in a second thread. A client
that sends no whole request for a while is closed, at once where a new client needs its place.
"""

import contextlib
import queue
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from edge.core.stop_words import as_stop, asks_to_stop
from edge.formats.reader import DocumentError, parse_json
from edge.sockets.client import encode_line
from edge.sockets.stop_file import StopFile
from edge.sockets.unix_socket import listen
from edge.tick.inbox import is_in_force, is_urgent
from edge.tick.status import reply_json

Ask = Callable[[Mapping[str, Any]], dict[str, Any]]
Post = Callable[[Mapping[str, Any], Callable[[dict[str, Any]], None]], None]

LINE_MAX = 65536  # longest request [bytes]
CLIENTS_MAX = 64
IDLE_MAX_S = 30.0  # without a whole request
GRACE_S = 0.05  # in which a new client can send its request before another one may take its place
ANSWER_MAX_S = 10.0  # after which a client is told that no answer came
SWEEP_S = 1.0  # between two looks for idle clients


@dataclass(slots=True, eq=False)
class _Client:
    """One connection and what is under way on it.

    A line is answered only when the answer before it is gone, and no more is read meanwhile: a client that
    does not read its answers holds up itself alone, in bounded memory.
    """

    connection: socket.socket
    since_s: float  # when it connected
    active_s: float  # when its last whole request came, or it connected
    unread: bytes = b""
    unsent: bytes = b""
    ended: bool = False  # nothing more comes, or nothing more is wanted
    waits_for: "_Question | None" = None  # that is being answered
    watched: int = 0  # events that the selector looks for

    @property
    def is_busy(self) -> bool:
        """There is a line to answer or an answer to send."""
        return bool(self.unsent) or self.waits_for is not None or b"\n" in self.unread

    @property
    def wanted(self) -> int:
        """Events to look for; none while an answer is waited for."""
        if self.waits_for is not None:
            return 0
        return selectors.EVENT_WRITE if self.is_busy else selectors.EVENT_READ

    def receive(self) -> None:
        data = self.connection.recv(LINE_MAX)
        self.ended = not data
        self.unread += data
        if len(self.unread) > LINE_MAX and b"\n" not in self.unread:
            self.refuse(f"request is longer than {LINE_MAX} bytes")

    def take_line(self) -> bytes | None:
        line, end, rest = self.unread.partition(b"\n")
        if self.unsent or self.waits_for is not None or not end:
            return None
        self.unread = rest
        return line

    def answer(self, reply: Mapping[str, Any]) -> None:
        self.waits_for, self.unsent = None, encode_line(reply)

    def refuse(self, reason: str) -> None:
        self.unread, self.ended = b"", True
        self.answer(_error(reason))

    def send(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self.unsent:
                self.unsent = self.unsent[self.connection.send(self.unsent) :]


@dataclass(frozen=True, slots=True, eq=False)
class _Question:
    """A request on its way, and who waits for its answer."""

    client: _Client
    request: Mapping[str, Any]

    @property
    def is_wanted(self) -> bool:
        return self.client.waits_for is self

    @property
    def is_urgent(self) -> bool:
        return is_urgent(self.request)


class ControlSocket:
    """Server side, in two threads of its own.

    ask : answers a request; may take its time
    stop_file : looked at every second; what it asks for is asked as if a client had
    post : gives an urgent request to the control thread without waiting, and a place for its answer
    Errors : ConfigError when the place is taken by a running daemon or can't hold a socket
    """

    def __init__(self, path: Path, ask: Ask, post: Post, stop_file: StopFile | None = None) -> None:
        self._path, self._ask, self._post = path, ask, post
        self._stop_file, self._stop_is_known = stop_file, False
        self._listener, self._inode = listen(path, "control_socket.path")
        self._wake, self._ring = socket.socketpair()
        self._wake.setblocking(False)
        self._ring.setblocking(False)
        self._closing = False
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._listens = True
        self._clients: dict[socket.socket, _Client] = {}
        self._sweep_at_s = 0.0
        self._questions: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
        self._answers: deque[tuple[_Question, dict[str, Any]]] = deque()
        self._threads = [
            threading.Thread(target=self._run, name="control-socket", daemon=True),
            threading.Thread(target=self._ask_all, name="control-requests", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Take the file away and end the threads; one that waits for an answer is left to its time limit."""
        with contextlib.suppress(OSError):
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()
        self._closing = True
        self._questions.put(None)
        self._wake_up()
        for thread in self._threads:
            thread.join(timeout_s)

    def _wake_up(self) -> None:
        with contextlib.suppress(OSError):  # full: it is awake; closed: nobody waits any more
            self._ring.send(b"\0")

    # the thread that reads and writes

    def _run(self) -> None:
        while not self._closing:
            for key, events in self._selector.select(SWEEP_S if self._listens else GRACE_S):
                if key.fileobj is self._wake:
                    self._hand_back()
                elif key.fileobj is self._listener:
                    self._accept_all()
                else:
                    self._serve(key.data, events)
            self._look_around(time.monotonic())
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        for end in (self._listener, self._wake, self._ring):
            end.close()

    def _hand_back(self) -> None:
        """Pass on the answers that have come; one that is not waited for any more is dropped."""
        with contextlib.suppress(BlockingIOError):
            while self._wake.recv(4096):
                pass
        while self._answers:
            question, reply = self._answers.popleft()
            if question.is_wanted:
                question.client.answer(reply_json(reply))
                self._serve(question.client, 0)

    def _accept_all(self) -> None:
        """Take in whoever waits, as far as there is room; what they have sent already is read at once."""
        while True:
            now = time.monotonic()
            is_full = len(self._clients) >= CLIENTS_MAX
            leaves = self._dispensable(now) if is_full else None
            if is_full and leaves is None:
                break
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                return
            except OSError:  # out of descriptors, or the client is gone again
                break
            if leaves is not None:
                self._hang_up(leaves, "another client needs the place")
            connection.setblocking(False)
            client = self._clients[connection] = _Client(connection, now, now)
            self._serve(client, selectors.EVENT_READ)
        self._selector.unregister(self._listener)  # until the next look around
        self._listens = False

    def _dispensable(self, now: float) -> _Client | None:
        """Return the client that has been idle for longest, None while all of them are new.

        A client that waits for an answer comes last, above all where it has asked for a stop.
        """
        settled = [client for client in self._clients.values() if now - client.since_s >= GRACE_S]
        return min(settled, key=_importance, default=None)

    def _look_around(self, now: float) -> None:
        if not self._listens:
            self._selector.register(self._listener, selectors.EVENT_READ)
            self._listens = True
        if now < self._sweep_at_s:
            return
        self._sweep_at_s = now + SWEEP_S
        self._look_for_stop()
        for client in list(self._clients.values()):
            if client.waits_for is not None and now - client.active_s > ANSWER_MAX_S:
                client.answer(_error(f"no answer within {ANSWER_MAX_S:g} s"))
                self._serve(client, 0)
            elif now - client.active_s > IDLE_MAX_S:
                self._hang_up(client, f"idle for {IDLE_MAX_S:g} s")

    def _look_for_stop(self) -> None:
        """Pass on a stop that was left on the disk, once."""
        if self._stop_file is None or (author := self._stop_file.author()) is None:
            self._stop_is_known = False
        elif not self._stop_is_known:
            self._stop_is_known = True
            self._post({"do": "emergency_stop", "by": author}, self._note_stop)

    def _note_stop(self, reply: dict[str, Any]) -> None:
        """Take an answer to it. Thread-safe. The file stays until the stop is on the disk elsewhere."""
        if reply.get("ok") and self._stop_file is not None:
            self._stop_file.take_away()
        self._stop_is_known = is_in_force(reply)

    def _serve(self, client: _Client, events: int) -> None:
        """One line at most, so that clients take turns."""
        try:
            if events & selectors.EVENT_READ:
                with contextlib.suppress(BlockingIOError):
                    client.receive()
            line = client.take_line()
            if line is not None:
                client.active_s = time.monotonic()
                self._take(client, line)
            client.send()
        except OSError:
            self._drop(client)
            return
        if client.ended and not client.is_busy:
            self._drop(client)
        else:
            self._watch(client, client.wanted)

    def _take(self, client: _Client, line: bytes) -> None:
        if len(line) > LINE_MAX:
            client.answer(_error(f"request is longer than {LINE_MAX} bytes"))
            return
        try:
            request = as_stop(parse_json(line, "request"))
        except DocumentError as error:
            if not asks_to_stop(line.decode(errors="replace")):
                client.answer(_error(str(error)))
                return
            request = {"do": "emergency_stop"}
        question = _Question(client, request)
        client.waits_for = question
        if question.is_urgent:
            self._post(question.request, partial(self._answer, question))
        else:
            self._questions.put(question)

    def _watch(self, client: _Client, events: int) -> None:
        if events == client.watched:
            return
        if not client.watched:
            self._selector.register(client.connection, events, client)
        elif events:
            self._selector.modify(client.connection, events, client)
        else:
            self._selector.unregister(client.connection)
        client.watched = events

    def _hang_up(self, client: _Client, reason: str) -> None:
        if not client.unsent:  # else the reason would stand in the middle of an answer
            client.refuse(reason)
        with contextlib.suppress(OSError):
            client.send()
        self._drop(client)

    def _drop(self, client: _Client) -> None:
        client.waits_for = None
        self._watch(client, 0)
        client.connection.close()
        self._clients.pop(client.connection, None)

    # the thread that asks

    def _ask_all(self) -> None:
        while (question := self._questions.get()) is not None:
            if not question.is_wanted:
                continue  # its client has left, or was told that no answer came
            try:
                self._answer(question, self._ask(question.request))
            except Exception as error:  # a bug must not close the way to the emergency stop
                self._answer(question, _error(f"internal error: {error!r}"))

    def _answer(self, question: _Question, reply: dict[str, Any]) -> None:
        """Answer a question. Thread-safe."""
        self._answers.append((question, reply))
        self._wake_up()


def _importance(client: _Client) -> tuple[int, float]:
    question = client.waits_for
    return (0 if question is None else 2 if question.is_urgent else 1), client.active_s


def _error(text: str) -> dict[str, Any]:
    return {"ok": False, "error": text}
