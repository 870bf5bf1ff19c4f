"""Lines typed while the step tests run: `p` pauses them for hands in the box, `g` goes on.

Both are the daemon's own maintenance, in which the board itself holds every output off.
"""

import os
import select
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from edge.core.errors import RequestError
from edge.sockets.client import request

PAUSE_MIN = 60.0  # a pause ends by itself then: longer than watering takes, shorter than a forgotten night
LINE_MAX = 256
LOOK_S = 1.0
WORDS = {"p": PAUSE_MIN, "pause": PAUSE_MIN, "g": 0.0, "go on": 0.0}
HELP = "p and Enter: pause, hands go into the box; g and Enter: go on; Ctrl-C: end the tests here"
SAID = {
    True: f"paused: heater and fan are off; g and Enter goes on, else it goes on in {PAUSE_MIN:g} min",
    False: "hands out: the box settles, then the tests go on",
}


class Hands:
    """Reads the terminal in a thread of its own. Use as a context manager.

    socket : of the daemon; say : prints a line
    source : descriptor to read from; None: standard input, where there is one
    """

    def __init__(self, socket: Path, say: Callable[[str], None], source: int | None = None) -> None:
        self._socket, self._say = socket, say
        self._source = _standard_input() if source is None else source
        self._wake, self._ring = os.pipe()
        self._thread = threading.Thread(target=self._run, name="hands", daemon=True)

    def __enter__(self) -> Self:
        if self._source is not None:
            if os.isatty(self._source):
                self._say(HELP)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.write(self._ring, b"\0")
        if self._thread.is_alive():
            self._thread.join()
        os.close(self._wake)
        os.close(self._ring)

    def _run(self) -> None:
        assert self._source is not None
        while True:
            # The kernel stops a process in the background that reads its terminal, and control with it.
            is_ours = not os.isatty(self._source) or os.tcgetpgrp(self._source) == os.getpgrp()
            ready, _, _ = select.select([self._wake, *([self._source] if is_ours else [])], [], [], LOOK_S)
            if self._wake in ready:
                return
            if self._source in ready:
                try:
                    data = os.read(self._source, LINE_MAX)
                except OSError:  # the terminal has gone
                    return
                if not data:
                    return
                for line in data.decode(errors="replace").splitlines():
                    self._take(line.strip().lower())

    def _take(self, word: str) -> None:
        minutes = WORDS.get(word)
        if minutes is None:
            self._say(HELP)
            return
        try:
            reply = request(self._socket, {"do": "maintenance", "minutes": minutes})
        except RequestError as error:
            reply = {"error": str(error)}
        if reply.get("ok"):
            self._say(str(reply.get("warning") or SAID[minutes > 0.0]))
        else:
            self._say(f"not done: {reply.get('error', reply)}")


def _standard_input() -> int | None:
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return None
