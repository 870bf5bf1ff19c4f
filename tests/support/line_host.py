"""A host for tests of the board: the link over a real port, in the simulated time of a `SimClock`."""

from typing import Any

from edge.board.serial_port import PortGone, SerialPort
from edge.board.sim_clock import SimClock
from firmware_protocol.link import Link, LinkEvent, Report
from firmware_protocol.messages import CommandMessage
from tests.support.virtual_board import VirtualBoard

RENEW_S = 3.0


class LineHost:
    """Greets, keeps what it received, and renews a command while it serves."""

    def __init__(self, board: VirtualBoard) -> None:
        self.clock = SimClock(board.control)
        self.received = b""
        self.events: list[LinkEvent] = []
        self.errors: list[PortGone] = []
        self.command: CommandMessage | None = None
        self._path = str(board.port)
        self._port: SerialPort | None = None
        self._link = Link(session=1, now=self.clock.now())
        self._renew_s = 0.0

    def __enter__(self) -> "LineHost":
        return self

    def __exit__(self, *_: object) -> None:
        self.close_port()
        self.clock.close()

    @property
    def up(self) -> bool:
        return self._link.state == "up"

    def seen(self, kind: type) -> list[Any]:
        """The events of one kind."""
        return [event for event in self.events if isinstance(event, kind)]

    def reports(self) -> list[Any]:
        return [event.report for event in self.seen(Report)]

    def heat(self) -> None:
        """From now on: full heat, fan off, cut-off closed, the longest lease."""
        self.command = CommandMessage(
            heater_steps=20, fan_on=0, led_pct=0, valve_pulse_s=0.0, cutoff_open=0, lease_s=10.0
        )
        self._renew_s = self.clock.now()

    def close_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def serve(self, until_s: float) -> None:
        """Keep the line alive until then."""
        while self.clock.now() < until_s:
            now = self.clock.now()
            self._open()
            self.events += self._link.poll(now)
            if self.command is not None and self.up and now >= self._renew_s:
                self._renew_s = now + RENEW_S
                self._link.request(self.command, now)
            try:
                self._exchange(min(until_s, self._link.next_deadline(), now + 1.0))
            except PortGone as error:
                self.errors.append(error)
                self.close_port()
                self.events += self._link.disconnect(self.clock.now())

    def _open(self) -> None:
        if self._port is None:
            try:
                self._port = SerialPort(self._path, 115200)
            except PortGone:
                return  # not plugged in: try again at the next turn

    def _exchange(self, until_s: float) -> None:
        if self._port is not None:
            self._port.write(self._link.outgoing())
        self.clock.wait(self._port, None, until_s)
        if self._port is not None:
            data = self._port.read()
            self.received += data
            self.events += self._link.receive(data, self.clock.now())
