"""Lines for a terminal, a pipe or the journal, written by a thread of their own: control never waits for one.

A device that is full or a reader that stalls costs lines, which are counted; what writes here goes on.
"""

import contextlib
import io
import os
import queue
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import TextIO

WAITING_MAX = 500  # texts that wait for a slow reader
TEXT_MAX = 65536  # characters of one text
CLOSE_S = 2.0  # that a reader which stalls may hold up the end


class Outlet(io.TextIOBase):
    """Stands in front of a text stream. `write` never waits and never raises, from any thread."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._descriptor = _descriptor(stream)
        self._texts: queue.SimpleQueue[str | Callable[[], str] | None] = queue.SimpleQueue()
        self._lost = 0  # texts since the last one that came through
        self._counting = threading.RLock()  # a destructor may print in the middle of counting
        self._error = ""
        self.reader_left = False  # nobody will ever read what is written
        self._thread = threading.Thread(target=self._run, name="outlet", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Take a text, or count it as lost where too many wait."""
        self._put(text[:TEXT_MAX])
        return len(text)

    def write_later(self, text: Callable[[], str]) -> None:
        """Take a text that the writing thread makes, so that a mistake in making it hurts nobody else."""
        self._put(text)

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the stream behind the outlet is a terminal."""
        return self._stream.isatty()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream behind the outlet."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def faults(self) -> Mapping[str, str]:
        """Return the fault of the failure table while texts are lost."""
        return {"output.behind": self._error or "nobody reads"} if self._lost else {}

    def finish(self, timeout_s: float = CLOSE_S) -> None:
        """Write what waits, for so long at most, and end the thread; texts that come later are lost."""
        self._texts.put(None)
        self._thread.join(timeout_s)

    def _put(self, text: str | Callable[[], str]) -> None:
        if self._texts.qsize() >= WAITING_MAX:
            self._count(1)
        else:
            self._texts.put(text)

    def _count(self, texts: int) -> None:
        with self._counting:
            self._lost += texts

    def _run(self) -> None:
        while (text := self._texts.get()) is not None:
            if callable(text):
                text = _make(text)
            lost = self._lost
            try:
                if lost:
                    self._send(f"({lost} lines were lost here: {self._error or 'nobody read'})\n")
                self._send(text)
            except OSError as error:
                self._count(1)
                self._error = error.strerror or str(error)
                self.reader_left = isinstance(error, BrokenPipeError)
            else:
                self._count(-lost)
                self._error = ""

    def _send(self, text: str) -> None:
        """Past Python's own buffer, whose lock would be missing at the end of the process. Errors: OSError"""
        if self._descriptor is None:
            self._stream.write(text)
            self._stream.flush()
            return
        data = memoryview(text.encode(self.encoding, "backslashreplace"))
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # a terminal that another program has set so
                select.select([], [self._descriptor], [])


@contextlib.contextmanager
def standard_output() -> Iterator[Outlet]:
    """Replace standard output and error by outlets that nobody in this
    process waits for, until the block ends.
    """
    out, errors = Outlet(sys.stdout), Outlet(sys.stderr)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            yield out
    finally:
        out.finish()
        errors.finish()


def _descriptor(stream: TextIO) -> int | None:
    try:
        return stream.fileno()
    except (OSError, ValueError):  # a stream in memory
        return None


def _make(text: Callable[[], str]) -> str:
    try:
        return text()
    except Exception as error:  # a line that cannot be made is no reason to write no further one
        return f"(a line could not be made: {error!r})\n"
