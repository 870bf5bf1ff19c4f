"""Surroundings of telemetry in tests: settings, a control loop that answers, an outbox in memory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from edge.config.settings import MqttSettings, Settings
from edge.core.controller_names import CONTROLLERS
from edge.core.errors import RequestError
from edge.core.messages import Command, Decision, Echo, Estimate, Event, Reading, ReadingQuality, TickRecord
from edge.mqtt.telemetry import Telemetry
from edge.tick.orders import Desk, Operation, operate
from edge.tick.status import LoopStatus, status_json

ROOT = "greenhouse/rig-1"


def settings(port: int = 1883, **mqtt: Any) -> Settings:
    """Defaults, but for the broker."""
    given = {"enabled": True, "host": "127.0.0.1", "port": port, "rig": "rig-1", **mqtt}
    return replace(Settings(), mqtt=MqttSettings(**given))


def record(
    seq: int = 1, temp_air: float | None = 24.5, events: tuple[Event, ...] = (), **changes: Any
) -> TickRecord:
    """One tick with a board that drives what it was sent."""
    command = Command(heater_duty=0.35)
    # Hardly two numbers are alike, so that a swap shows.
    tick = TickRecord(
        seq=seq,
        time_s=100.0,
        utc=1.7e9,
        step_s=60.0,
        mode="auto",
        readings={"temp_air": Reading("temp_air", temp_air, 99.0, ReadingQuality.GOOD)},
        estimate=Estimate(24.4, 0.1, 0.0, 0.1, 21.0, 99.0),
        reference_c=26.0,
        decision=Decision(command, "MPC", (24.9, 25.3), {"solve_ms": 1.5}),
        wanted=command,
        changes=(),
        sent=command,
        echo=Echo(0.35, False, 0.0, False, False, "", 100.1),
        link_up=True,
        events=events,
        ticks_skipped=0,
        late_s=0.0,
        decide_ms=2.0,
    )
    return replace(tick, **changes)


class ControlLoop:
    """Answers requests as the real one does, without a board."""

    def __init__(self) -> None:
        self.operation = Operation("MPC")
        self.trips: tuple[str, ...] = ()
        self.last_record = record()
        self.echo: Echo | None = None  # newer than the last tick's
        self.requests: list[Mapping[str, Any]] = []
        self.resend: Callable[[int, int], int] = lambda first, last: 0

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Answer as the control loop does; an order changes `operation`, all but status is noted."""
        if request["do"] != "status":
            self.requests.append(request)
        if request["do"] == "resend":
            span = {key: request[key] for key in ("first_seq", "last_seq")}
            return {"ok": True, "queued": self.resend(*span.values()), **span}
        if request["do"] not in ("status", "clear_trip"):
            try:
                self.operation = operate(self.operation, request, desk())
            except RequestError as error:
                return {"ok": False, "error": str(error)}
        return {"ok": True, **self.status()}

    def post(self, request: Mapping[str, Any], answered: Callable[[dict[str, Any]], None]) -> None:
        """Answer at once, in the thread of the asker."""
        answered(self.ask(request))

    def status(self) -> dict[str, Any]:
        """As JSON, without the line's counters, as of a recorded board."""
        values = status_json(self.values())
        del values["line"]
        return values

    def values(self) -> LoopStatus:
        """Return the status of the last record."""
        record = self.last_record
        echo = self.echo or record.echo
        return LoopStatus(self.operation.at(record.utc), 0.0, self.trips, record, echo, record.link_up, {})


def tick(telemetry: Telemetry, made: TickRecord, loop: ControlLoop | None = None) -> None:
    """Hand a tick out, as the loop does."""
    telemetry.write(made)
    telemetry.show((loop or ControlLoop()).values())


@dataclass(frozen=True)
class OutboxRow:
    """One message of an outbox."""

    id: int
    topic: str
    payload: str


class MemoryOutbox:
    """An outbox of `count` rows numbered from 1; keeps what was acknowledged."""

    def __init__(self, count: int = 0) -> None:
        self.rows = {number: row(number) for number in range(1, count + 1)}
        self.acknowledged: list[int] = []

    def pending(self, limit: int) -> Sequence[OutboxRow]:
        """Return the oldest rows, at most `limit`."""
        return [self.rows[key] for key in sorted(self.rows)[:limit]]

    def acknowledge(self, ids: Sequence[int]) -> None:
        """Remove rows. Errors: KeyError for a row that is not there"""
        for key in ids:
            del self.rows[key]
        self.acknowledged.extend(ids)

    def depth(self) -> int:
        """Return how many rows wait."""
        return len(self.rows)

    def resend(self, first_seq: int, last_seq: int) -> int:
        """Put the numbered rows back and return how many."""
        self.rows.update({number: row(number) for number in range(first_seq, last_seq + 1)})
        return last_seq - first_seq + 1


def row(number: int) -> OutboxRow:
    """Return a message of the history with this number."""
    return OutboxRow(number, f"{ROOT}/history", f'{{"history_id":"h1","seq":{number}}}')


def desk() -> Desk:
    """Return the rules by which orders are checked: fixed time, 15 to 38 degC."""
    return Desk(utc=1.7e9, controllers=CONTROLLERS, reference_min_c=15.0, reference_max_c=38.0)
