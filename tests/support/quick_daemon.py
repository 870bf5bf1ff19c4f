"""A stand-in for the daemon whose status differs at each look, and a page that looks often.

A day of an open browser passes in minutes. It sees the values of a real rig's ticks, which also go to the
history.
"""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from typing import Any

from edge.core.messages import Event, Severity, TickRecord
from edge.formats.reader import parse_json
from edge.sockets.client import encode_line
from edge.storage.file import connect
from edge.storage.tick_rows import insert_ticks
from edge.tick.orders import Operation
from edge.tick.status import LoopStatus, status_json
from tests.support.broker import free_port
from tests.support.page_process import PageProcess

STEP_S = 60.0
FIRST_UTC = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
EVENT_EVERY_TICKS = 30  # one made-up warning, and its end at the next tick
LINES = tuple(
    f"{number}. MPC-P wanted heater 0.35, fan off. Its plan costs 0.42: tracking 0.3." for number in range(12)
)
_LOOK_OFTEN = (
    "import sys; from edge.page import rig_link; rig_link.WATCHED_S = float(sys.argv[2]);"
    " from edge.page.__main__ import main; sys.exit(main(sys.argv[1]))"
)


def move(record: TickRecord, seq: int) -> TickRecord:
    """Return a tick as number `seq`."""
    utc = FIRST_UTC + STEP_S * seq
    events = tuple(replace(event, utc=utc) for event in record.events)
    if seq % EVENT_EVERY_TICKS < 2:
        over = ".over" if seq % EVENT_EVERY_TICKS else ""
        events += (Event(f"reading.not_good{over}", Severity.WARNING, "spike", 0.0, utc),)
    return replace(record, seq=seq, utc=utc, time_s=STEP_S * seq, events=events)


class QuickDaemon(ThreadingUnixStreamServer):
    """Answers "status" and "why" at a socket in `folder`, and goes on with the history there.

    template : its ticks, again and again; looks_a_tick : statuses until the next one
    """

    daemon_threads = True

    def __init__(self, folder: Path, template: Sequence[TickRecord], looks_a_tick: int) -> None:
        self._history, self._template, self._looks_a_tick = folder / "history.db", template, looks_a_tick
        self._lock, self.looks = threading.Lock(), 0
        self.is_still = False  # then every look sees the same
        with closing(connect(self._history, 10.0)) as connection:
            self.first_seq = 1 + int(connection.execute("SELECT max(seq) FROM ticks").fetchone()[0])
        self.record = self._tick(self.first_seq)
        super().__init__(str(folder / "daemon.sock"), _QuickAnswer)

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer of a daemon."""
        if message.get("do") == "why":
            seq = self.record.seq
            return {"ok": True, "seq": seq, "lines": [f"At tick {seq}:", *LINES]}
        with self._lock:
            self.looks += not self.is_still
            looks, seq = self.looks, self.first_seq + self.looks // self._looks_a_tick
            if seq != self.record.seq:
                self.record = self._tick(seq)
                self._store(self.record)
            record = self.record
        echo = record.echo and replace(record.echo, heater_duty=0.05 * (looks % 21))
        line = {"frames": looks, "bad_crc": looks // 1000}
        return {
            "ok": True,
            **status_json(LoopStatus(Operation("MPC-P"), float(looks), (), record, echo, True, line)),
        }

    def _tick(self, seq: int) -> TickRecord:
        return move(self._template[seq % len(self._template)], seq)

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
def quick_rig(
    folder: Path, template: Sequence[TickRecord], looks_a_tick: int, look_s: float
) -> Iterator[tuple[QuickDaemon, QuickPage]]:
    """Start both on the history in `folder`."""
    page = QuickPage(folder, free_port())
    page.look_s = look_s
    (folder / "daemon.sock").unlink(missing_ok=True)
    with QuickDaemon(folder, template, looks_a_tick) as daemon:
        threading.Thread(target=daemon.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        try:
            page.start()
            yield daemon, page
        finally:
            page.kill()
            daemon.shutdown()
