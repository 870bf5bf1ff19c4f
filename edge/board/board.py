"""The board at the other end of a serial line: the one place in edge/ that knows the wire.

Everything here is a value or an event: an unplugged port, a lost link or a refused command never raises.
"""

import math
import select
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

from edge.board.serial_port import OpenPort, PortGone, SerialPort, WirePort
from edge.core.clock import Clock
from edge.core.errors import RequestError
from edge.core.event_log import EventLog
from edge.core.hard_limits import LEASE_S
from edge.core.messages import AirSensorPair, Command, Echo, Event, Reading, ReadingQuality, Severity
from edge.core.names import HEATER_LEVELS, SIGNALS
from firmware_protocol import link as wire
from firmware_protocol import messages as wire_messages
from firmware_protocol.messages import PROTOCOL_VERSION, Capability

RENEW_S = 3.0  # so two renewals may be lost before a lease ends
FAN_TIME_PER_S = 4  # of the wire's fan_on
FAN_TIME_MIN, FAN_TIME_MAX = 2, 255
REOPEN_S = 1.0  # between two tries to open a missing port
SAMPLES_KEPT = 600  # reports between two ticks; more are dropped, oldest first

_QUALITY = {
    wire_messages.Quality.GOOD: ReadingQuality.GOOD,
    wire_messages.Quality.STALE: ReadingQuality.STALE,
    wire_messages.Quality.RANGE: ReadingQuality.RANGE,
    wire_messages.Quality.FAULT: ReadingQuality.FAULT,
    wire_messages.Quality.ABSENT: ReadingQuality.ABSENT,
}

_VALUES = attrgetter(*(signal.key for signal in SIGNALS.values()))
_QUALITIES = attrgetter(*(f"{name}_quality" for name in SIGNALS))

Sample = Mapping[str, Reading]
LatchOrder = (
    wire_messages.EmergencyStop
    | wire_messages.ReleaseStop
    | wire_messages.Maintenance
    | wire_messages.EndMaintenance
    | wire_messages.ClearTrip
)
# Sent anew whenever the link comes up.
STANDING = (wire_messages.EmergencyStop, wire_messages.Maintenance)


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """The board's order, and the time until which it holds without a new decision."""

    command: Command
    cutoff_open: bool
    until_s: float
    fan_until_s: float


class Board:
    """An open port (or none), its link, and what the board said last."""

    def __init__(
        self,
        path: str,
        baudrate: int,
        clock: Clock,
        session: int,
        open_port: OpenPort = SerialPort,
        pinned: int | None = None,  # id of the only board that is driven; None: the first that answers
        save_pin: Callable[[int], None] = lambda board_id: None,
    ) -> None:
        self._path = path
        self._baudrate = baudrate
        self._open_port = open_port
        self._clock = clock
        self._pinned, self._save_pin = pinned, save_pin
        self._link = wire.Link(session=session, now=clock.now())
        self._port: WirePort | None = None
        self._open_at_s = clock.now()
        self._open_failed = False
        self._driven: DriveOrder | None = None
        self._renew_at_s = float("inf")
        self._asked: wire_messages.CommandMessage | None = None  # the newest command, until it is confirmed
        self._orders: dict[str, LatchOrder] = {}  # by latch: the newest; all but stops until answered
        self._unanswered: set[str] = set()  # latches
        self._samples: list[Sample] = []
        self._events = EventLog()
        self.echo: Echo | None = None
        self.air_pair: AirSensorPair | None = None  # None for a board with one air sensor
        self.hello: wire_messages.Hello | None = None

    @property
    def link_up(self) -> bool:
        """The pinned board answers and speaks our version."""
        return self._answers and not self.foreign

    @property
    def foreign(self) -> str:
        """Ids of a board that answers and of the pinned one, "" where they are the same."""
        if not self._answers or self.hello is None or self._pinned in (None, self.hello.board_id):
            return ""
        return f"board {self.hello.board_id} answers, board {self._pinned} is pinned"

    @property
    def _answers(self) -> bool:
        return self._port is not None and self._link.state == "up"

    @property
    def in_maintenance(self) -> bool:
        """The board holds everything off for maintenance, or is ordered to."""
        ordered = isinstance(self._orders.get("maintenance"), wire_messages.Maintenance)
        return ordered or (self.echo is not None and self.echo.trip_cause == "maintenance")

    @property
    def has_samples(self) -> bool:
        """A sensor report waits to be taken."""
        return bool(self._samples)

    @property
    def statistics(self) -> Mapping[str, int]:
        """Counters of the line since the start."""
        return self._link.statistics

    def take_samples(self) -> list[Sample]:
        """Return the sensor reports since the last call, oldest first."""
        samples, self._samples = self._samples, []
        return samples

    def take_events(self) -> list[Event]:
        """Return the line's events since the last call, bounded however often the link comes and goes."""
        return self._events.take()

    def drive(self, command: Command, cutoff_open: bool, step_s: float) -> None:
        """Send a decision; its lease is renewed for a step and, without a new one, one lease more."""
        now = self._clock.now()
        fan_s = math.inf if command.fan_at_end else command.fan * step_s
        self._driven = DriveOrder(command, cutoff_open, now + step_s + LEASE_S, now + fan_s)
        self._asked = None
        if self.link_up:
            self._send_command(now)
        # The valve pulse is given once; a renewal must not open the valve again.
        self._driven = replace(self._driven, command=replace(command, valve_pulse_s=0.0))

    def emergency_stop(self) -> None:
        """Turn everything off at once and latch it on the board; without a link, as soon as it is up."""
        self._driven = None
        self._order("stop", wire_messages.EmergencyStop())

    def release_stop(self) -> None:
        """End the board's emergency stop; waits for the link likewise."""
        self._order("stop", wire_messages.ReleaseStop())

    def maintain(self) -> None:
        """Do what `emergency_stop` does, under the latch of maintenance."""
        self._driven = None
        self._order("maintenance", wire_messages.Maintenance())

    def end_maintenance(self) -> None:
        """End the board's maintenance; waits for the link likewise."""
        self._order("maintenance", wire_messages.EndMaintenance())

    def clear_trip(self) -> None:
        """Ask the board to forget its trip; it refuses while the cause lasts. Waits for the link likewise."""
        self._order("trip", wire_messages.ClearTrip())

    def accept(self) -> tuple[bool, str]:
        """Pin the board that answers; return whether it is a new one, and what holds. Errors: RequestError"""
        if not self._answers or self.hello is None or not self.hello.board_id:
            raise RequestError("no board that is configured answers at the port")
        number, before = self.hello.board_id, self._pinned
        if not self.foreign:
            return False, f"Nothing changed: board {number}, at the port, is already this rig's."
        self._pin(number)
        self._begin()
        said = f"Board {number} is this rig's board from now on (before: {before})."
        return True, f"{said} It is driven from the next step on."

    def serve(
        self, until_s: float, wake: int | None = None, done: Callable[[], bool] = lambda: False
    ) -> None:
        """Keep the line alive until `until_s`, a byte on `wake`, or `done()`."""
        while True:
            now = self._clock.now()
            self._keep_open(now)
            self._read(now)  # first: after a long wait what has arrived must not count as silence
            self._take(self._link.poll(now), now)
            self._renew(now)
            self._flush(now)
            if now >= until_s or done():
                return
            self._clock.wait(self._port, wake, min(until_s, self._next_deadline()))
            if wake is not None and _readable(wake):
                return

    def serve_until_echo(self, timeout_s: float) -> Echo | None:
        """Wait for the board's answer to the last command; None when it does not come in time."""
        self.serve(self._clock.now() + timeout_s, done=lambda: self._asked is None)
        return self.echo if self._asked is None and self.link_up else None

    def serve_until_answered(self, timeout_s: float) -> bool:
        """Wait for the board's answers to stops, releases and clear_trip; False when one is missing."""
        if self.link_up:
            self.serve(self._clock.now() + timeout_s, done=lambda: not self._unanswered or not self.link_up)
        return not self._unanswered

    def close(self) -> None:
        """Close the port; what the board drives ends with its lease."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _next_deadline(self) -> float:
        if self._port is None:
            return self._open_at_s
        return min(self._link.next_deadline(), self._renew_at_s)

    def _keep_open(self, now: float) -> None:
        if self._port is not None or now < self._open_at_s:
            return
        try:
            self._port = self._open_port(self._path, self._baudrate)
        except PortGone as error:
            self._open_at_s = now + REOPEN_S
            if not self._open_failed:
                self._open_failed = True
                self._tell("board.port_missing", Severity.ALARM, f"{self._path} can't be opened: {error}")
            return
        self._open_failed = False
        self._tell("board.port_open", Severity.INFO, f"{self._path} is open")

    def _lose_port(self, error: PortGone, now: float) -> None:
        self.close()
        self._open_at_s = now + REOPEN_S
        self._open_failed = True
        self._take(self._link.disconnect(now), now)
        self._tell("board.unplugged", Severity.ALARM, f"{self._path} is gone: {error}")

    def _read(self, now: float) -> None:
        if self._port is None:
            return
        try:
            data = self._port.read()
        except PortGone as error:
            self._lose_port(error, now)
            return
        if data:
            self._take(self._link.receive(data, now), now)

    def _flush(self, now: float) -> None:
        if self._port is None:
            return
        data = self._link.outgoing()
        if not data:
            return
        try:
            self._port.write(data)
        except PortGone as error:
            self._lose_port(error, now)

    def _send_command(self, now: float) -> None:
        assert self._driven is not None and self.hello is not None
        parts = Capability(self.hello.capabilities)
        fan_left_s = self._driven.fan_until_s - now
        self._renew_at_s = now + (min(RENEW_S, fan_left_s) if fan_left_s > 0.0 else RENEW_S)
        lease_s = min(LEASE_S, self._driven.until_s - now)
        self._asked = _message(self._driven, parts, lease_s, fan_left_s)
        self._link.request(self._asked, now)

    def _order(self, latch: str, order: LatchOrder) -> None:
        self._orders[latch] = order
        self._unanswered.add(latch)
        self._request(order)  # else LinkUp sends it

    def _request(self, order: LatchOrder) -> None:
        """Send an order where it may be sent: a board that is not the pinned one is turned off, no more."""
        if self.link_up or (self.foreign and isinstance(order, STANDING)):
            self._link.request(order, self._clock.now())

    def _greet(self, hello: wire_messages.Hello) -> None:
        self.hello = hello
        if self._pinned is None and hello.board_id:  # 0: it is not configured yet
            self._pin(hello.board_id)
        self._begin()
        firmware = f"{hello.firmware_major}.{hello.firmware_minor}.{hello.firmware_patch}"
        self._tell("board.link_up", Severity.INFO, f"board {hello.board_id}, firmware {firmware}")

    def _begin(self) -> None:
        """Renew at once, since until a lease the board drives nothing; orders go before any command."""
        self._renew_at_s = self._clock.now()
        for order in self._orders.values():
            self._request(order)

    def _pin(self, board_id: int) -> None:
        self._pinned = board_id
        self._save_pin(board_id)
        text = "is pinned: no other one is driven at this port before `greenhouse board accept`"
        self._tell("board.pinned", Severity.INFO, f"board {board_id} {text}")

    def _settle(self, request: wire_messages.Message | None) -> None:
        """Note that the board has answered one of the orders."""
        for latch, order in list(self._orders.items()):
            if order is request:
                self._unanswered.discard(latch)
                if not isinstance(order, STANDING):
                    del self._orders[latch]

    def _renew(self, now: float) -> None:
        if now < self._renew_at_s:
            return
        self._renew_at_s = float("inf")  # a link that comes up renews at once
        if self._driven is not None and not now < self._driven.until_s:
            self._driven = None  # no new decision came: let the lease run out
        if self._driven is not None and self.link_up:
            self._send_command(now)

    def _take(self, events: list[wire.LinkEvent], now: float) -> None:
        for event in events:
            match event:
                case wire.Report(report):
                    self._samples.append(_readings(report, now))
                    del self._samples[:-SAMPLES_KEPT]
                case wire.PairTold(pair):
                    apart = pair.verdict is wire_messages.AirVerdict.APART
                    self.air_pair = AirSensorPair(pair.first_c, pair.second_c, apart)
                case wire.LinkEcho(state, request):
                    self._take_echo(state, request, now)
                case _:
                    self._tell_link(event)

    def _take_echo(
        self, state: wire_messages.StateEcho, request: wire_messages.Message | None, now: float
    ) -> None:
        cause_before = "" if self.echo is None else self.echo.trip_cause
        share = 1.0 if self._driven is None else self._driven.command.fan_share
        self.echo = _echo(state, now, share)
        if request is self._asked:  # an older command's echo says nothing of the newest one
            self._asked = None
        self._settle(request)
        if self.echo.tripped and self._driven is not None:  # it refuses heat, and while stopped everything
            rest = Command() if self.echo.stopped else replace(self._driven.command, heater_duty=0.0)
            self._driven = replace(self._driven, command=rest)
        if self.echo.tripped and self.echo.trip_cause != cause_before:
            severity = Severity.INFO if self.echo.trip_cause == "maintenance" else Severity.ALARM
            self._tell("board.tripped", severity, f"the board has tripped: {self.echo.trip_cause}")

    def _tell_link(self, event: wire.LinkEvent) -> None:
        match event:
            case wire.LinkUp(hello):
                self._greet(hello)
            case wire.LinkLost(silent_s):
                self.echo = self.air_pair = None
                self._tell(
                    "board.link_lost", Severity.ALARM, f"the board has been silent for {silent_s:.1f} s"
                )
            case wire.BoardReset(hello):
                cause = wire_messages.ResetCause(hello.reset_cause).name.lower()
                self._tell(
                    "board.reset", Severity.WARNING, f"the board has reset ({cause}), boot {hello.boot_count}"
                )
            case wire.VersionRefused(low, high):
                text = f"the board speaks protocol {low} to {high}, not {PROTOCOL_VERSION}"
                self._tell("board.version", Severity.ALARM, text)
            case wire.RequestRefused(error, request):
                self._settle(request)
                code = wire_messages.ErrorCode(error.code).name.lower()
                text = f"the board refused {type(request).__name__}: {code} ({error.detail})"
                self._tell("board.refused", Severity.WARNING, text)
            case wire.RequestTimedOut(request):
                for order in self._orders.values():
                    if order is request:
                        self._request(order)  # a stop went ahead of it
                self._tell("board.no_answer", Severity.WARNING, f"no answer to {type(request).__name__}")
            case wire.Nonsense():
                pass  # counted in `statistics`

    def _tell(self, key: str, severity: Severity, text: str) -> None:
        self._events.add(Event(key, severity, text, self._clock.now(), self._clock.utc()))


def _readable(descriptor: int) -> bool:
    return bool(select.select([descriptor], [], [], 0)[0])


def _message(
    driven: DriveOrder, parts: Capability, lease_s: float, fan_left_s: float
) -> wire_messages.CommandMessage:
    """Return the command without parts that this board lacks: it refuses a command that drives one."""
    command = driven.command
    return wire_messages.CommandMessage(
        heater_steps=round(command.heater_duty * HEATER_LEVELS),
        fan_on=_fan_time(fan_left_s, Capability.FAN_TIME in parts) if command.fan_on else 0,
        led_pct=round(command.led * 100) if Capability.LED in parts else 0,
        valve_pulse_s=command.valve_pulse_s if Capability.VALVE in parts else 0.0,
        cutoff_open=driven.cutoff_open and Capability.HEATER_CUTOFF in parts,
        lease_s=lease_s,
    )


def _fan_time(left_s: float, timed: bool) -> int:
    """Return the wire's number for a fan that is on for `left_s` more.

    timed : the board ends that time by itself; for one that does not, the host commands it when it is over
    """
    if left_s <= 0.0:
        return 0
    if not timed or math.isinf(left_s):
        return 1
    return min(max(round(left_s * FAN_TIME_PER_S), FAN_TIME_MIN), FAN_TIME_MAX)


def _readings(report: wire_messages.SensorReport, now: float) -> Sample:
    values, qualities = _VALUES(report), _QUALITIES(report)
    return {
        name: Reading(name, value, now, _QUALITY[quality])
        for name, value, quality in zip(SIGNALS, values, qualities, strict=True)
    }


def _echo(state: wire_messages.StateEcho, now: float, fan_share: float) -> Echo:
    cause = wire_messages.TripCause(state.trip_cause)
    return Echo(
        heater_duty=state.heater_steps / HEATER_LEVELS,
        fan_on=bool(state.fan_on),
        led=state.led_pct / 100,
        valve_open=bool(state.valve_open),
        tripped=bool(state.tripped),
        trip_cause="" if cause is wire_messages.TripCause.NONE else cause.name.lower(),
        time_s=now,
        fan_share=fan_share,
    )
