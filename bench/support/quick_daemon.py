"""A stand-in for the daemon whose status differs at each look, and a page that looks often.

A day of an open browser passes in minutes. It sees the values of a real rig's ticks, which also go to the
history.
"""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from typing import Any

from bench.history_year import move
from bench.support.broker import free_port
from bench.support.page_process import PageProcess
from edge.core.messages import TickRecord
from edge.formats.reader import parse_json
from edge.sockets.client import encode_line
from edge.storage.file import connect
from edge.storage.tick_rows import insert_ticks
from edge.tick.orders import Operation
from edge.tick.status import LoopStatus, status_json

LINES = tuple(
    f"{number}. MPC-P wanted heater 0.35, fan off. Its plan costs 0.42: tracking 0.3." for number in range(12)
)
_LOOK_OFTEN = (
    "import sys; from edge.page import rig_link; rig_link.WATCHED_S = float(sys.argv[2]);"
    " from edge.page.__main__ import main; sys.exit(main(sys.argv[1]))"
)


@dataclass(frozen=True, slots=True)
class QuickTicks:
    """Ticks to come. template : repeated; first_seq : number of the first; looks : at each of them"""

    template: Sequence[TickRecord]
    first_seq: int
    looks: int

    def at(self, look: int) -> TickRecord:
        """Return the newest tick at a look."""
        seq = self.first_seq + look // self.looks
        return move(self.template[seq % len(self.template)], seq)


class QuickDaemon(ThreadingUnixStreamServer):
    """Answers "status" and "why" at a socket in `folder`, and writes its ticks to the history there."""

    daemon_threads = True

    def __init__(self, folder: Path, ticks: QuickTicks) -> None:
        self._history, self._ticks = folder / "history.db", ticks
        self._lock, self._looks = threading.Lock(), 0
        self.is_still = False  # then every look sees the same
        self.record = ticks.at(0)
        super().__init__(str(folder / "daemon.sock"), _QuickAnswer)

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer of a daemon."""
        if message.get("do") == "why":
            seq = self.record.seq
            return {"ok": True, "seq": seq, "lines": [f"At tick {seq}:", *LINES]}
        with self._lock:
            self._looks += not self.is_still
            record, looks = self._ticks.at(self._looks), self._looks
            if record.seq != self.record.seq:
                self._store(record)
            self.record = record
        echo = record.echo and replace(record.echo, heater_duty=0.05 * (looks % 21))
        line = {"frames": looks, "bad_crc": looks // 1000}
        return {
            "ok": True,
            **status_json(LoopStatus(Operation("MPC-P"), float(looks), (), record, echo, True, line)),
        }

    def _store(self, record: TickRecord) -> None:
        with closing(connect(self._history, 10.0)) as connection:
            connection.execute("BEGIN")
            insert_ticks(connection, [record], session=1)
            connection.execute("COMMIT")


class _QuickAnswer(StreamRequestHandler):
    def handle(self) -> None:
        """Answer one request."""
        assert isinstance(self.server, QuickDaemon)
        message = parse_json(self.rfile.readline(), "a request")
        self.wfile.write(encode_line(self.server.answer(message)))


class QuickPage(PageProcess):
    """A page that looks at its daemon every `look_s`."""

    look_s = 1.0

    @property
    def command(self) -> list[str]:
        """Return its command line."""
        return [sys.executable, "-c", _LOOK_OFTEN, str(self.config), str(self.look_s)]


@contextmanager
def quick_rig(folder: Path, ticks: QuickTicks, look_s: float) -> Iterator[tuple[QuickDaemon, QuickPage]]:
    """Start both on the history in `folder`."""
    page = QuickPage(folder, free_port())
    page.look_s = look_s
    (folder / "daemon.sock").unlink(missing_ok=True)
    with QuickDaemon(folder, ticks) as daemon:
        threading.Thread(target=daemon.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        try:
            page.start()
            yield daemon, page
        finally:
            page.kill()
            daemon.shutdown()
