"""A rig of a fleet without a board: the daemon's own history, outbox and telemetry, and ticks made up."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from edge.config.settings import HistorySettings
from edge.core.clock import RealClock
from edge.core.messages import Event
from edge.mqtt.telemetry import Telemetry
from edge.mqtt.topics import Topics
from edge.storage import Outbox, Storage
from edge.tick.orders import Operation
from tests.support.mqtt_rig import ControlLoop, record, settings


class RigWithoutBoard:
    """`with RigWithoutBoard(folder, "rig-1", port) as rig: rig.tick()`; a tick is stored when it returns."""

    def __init__(self, folder: Path, name: str, port: int) -> None:
        self.name = name
        self.sent: dict[int, float] = {}  # sequence number -> utc
        self._path = str(folder / f"{name}.db")
        self._settings = settings(port, rig=name)
        self._storage = Storage(HistorySettings(path=self._path), RealClock())
        self._next_seq = self._storage.open()
        self._loop = ControlLoop()
        self._loop.resend = self._resend
        self.telemetry: Telemetry | None = None
        self.twin: Path | None = None  # file of the twin that runs
        self._root = Topics.of(self._settings.mqtt).root

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.disconnect()
        self._storage.close()

    def connect(self) -> None:
        """Begin to talk to the broker."""
        self.telemetry = Telemetry(
            self._settings,
            self._loop.ask,
            self._loop.post,
            lambda: Outbox(self._path, self._root),
            lambda: self.twin,
        )

    def disconnect(self) -> None:
        """End the connection; ticks go on and wait."""
        if self.telemetry is not None:
            self.telemetry.close()
            self.telemetry = None

    def tick(
        self, utc: float | None = None, events: tuple[Event, ...] = (), waits: bool = True, **changes: Any
    ) -> int:
        """Make one tick, now unless `utc` is given; return its number. waits : until it is in the history"""
        seq = self._next_seq
        at = self._new_time() if utc is None else round(utc, 3)
        made = record(seq, 20.0 + seq % 100 / 10, events, utc=at, **changes)
        self._next_seq += 1
        self._storage.write(made)
        assert not waits or self._storage.wait_written(seq, 20.0)
        self.sent[seq] = at
        self._loop.last_record = made
        if self.telemetry is not None:
            self.telemetry.write(made)
            self.telemetry.show(self._loop.values())
        return seq

    def _new_time(self) -> float:
        """Return the time, that of no tick before: the store keeps one sample of a millisecond."""
        while (now := round(time.time(), 3)) in self.sent.values():
            time.sleep(0.0005)
        return now

    @property
    def operation(self) -> Operation:
        """The orders that its control loop follows."""
        return self._loop.operation

    def depth(self) -> int:
        """Return how many messages wait for the broker's word."""
        outbox = Outbox(self._path, self._root)
        try:
            return outbox.depth()
        finally:
            outbox.close()

    def _resend(self, first: int, last: int) -> int:
        outbox = Outbox(self._path, self._root)
        try:
            return outbox.resend(first, last)
        finally:
            outbox.close()


def every(seconds: float, do: Callable[[], object], until: Callable[[], bool]) -> None:
    """Call `do` at a steady pace until a condition holds."""
    next_s = time.monotonic()
    while not until():
        do()
        next_s += seconds
        time.sleep(max(0.0, next_s - time.monotonic()))
