"""A loop wired to a board, a clock and controllers of a few lines each; time moves when a test says so."""

import json
import math
import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.clock import Moment
from edge.core.controller import Context
from edge.core.messages import (
    AirSensorPair,
    Command,
    Decision,
    Echo,
    Event,
    Reading,
    ReadingQuality,
    TickRecord,
)
from edge.models.arx_file import read_arx
from edge.safety.supervisor import SafetyMemory
from edge.state.codecs import StandingState, carry_on, decode_standing, encode_limits, encode_standing
from edge.state.store import LIMITS
from edge.tick.estimator import Estimator
from edge.tick.inbox import Inbox, Letter, Reply
from edge.tick.loop import Loop
from edge.tick.orders import Operation
from edge.tick.reference import make_reference
from edge.tick.rig import Answered, NoForecasts, Rig
from edge.tick.sensor_health import SensorHealth
from edge.tick.status import reply_json

UTC_0 = 1_750_000_000.0


@dataclass
class FakeClock:
    now_s: float = 0.0
    utc_offset: float = UTC_0

    def now(self) -> float:
        return self.now_s

    def utc(self) -> float:
        return self.now_s + self.utc_offset

    def wait(self, port: object, wake: int | None, until_s: float) -> None:
        self.now_s = max(self.now_s, until_s)


@dataclass
class FakeBoard:
    """Reports `temp_air` every second with `quality`; confirms every command unless told not to."""

    clock: FakeClock
    temp_air: float | None = 22.0
    quality: ReadingQuality = ReadingQuality.GOOD
    link_up: bool = True
    confirms: bool = True
    tripped: bool = False
    foreign: str = ""
    echo: Echo | None = None
    air_pair: AirSensorPair | None = None
    driven: list[tuple[Command, bool, float]] = field(default_factory=list)
    commanded: Command = field(default_factory=Command)
    stopped: bool = False
    maintained: bool = False
    stops: int = 0
    cleared: int = 0
    soil: float | None = None  # of a board that waters, whose tank is full
    keeps_trip: bool = False
    _sampled_s: float = -1.0

    @property
    def has_samples(self) -> bool:
        return self.link_up

    @property
    def statistics(self) -> Mapping[str, int]:
        return {}

    def take_samples(self) -> list[Mapping[str, Reading]]:
        samples = []
        while self.link_up and self._sampled_s + 1.0 <= self.clock.now_s:
            self._sampled_s += 1.0
            others = {"temp_ambient": 21.0}
            if self.soil is not None:
                others |= {"soil_moisture": self.soil, "tank_level": 1.0}
            samples.append(
                {"temp_air": Reading("temp_air", self.temp_air, self._sampled_s, self.quality)}
                | {k: Reading(k, v, self._sampled_s, ReadingQuality.GOOD) for k, v in others.items()}
            )
        return samples

    def take_events(self) -> list[Event]:
        return []

    def drive(self, command: Command, cutoff_open: bool, step_s: float) -> None:
        self.driven.append((command, cutoff_open, step_s))
        if self.link_up and self.confirms:
            self.commanded = command
            self._say()

    def _say(self) -> None:
        cause = "emergency_stop" if self.stopped else "maintenance" if self.maintained else ""
        command = Command() if cause else self.commanded
        duty = 0.0 if self.tripped else command.heater_duty
        tripped = self.tripped or bool(cause)
        cause = cause or "over_temperature" * self.tripped
        self.echo = Echo(duty, command.fan_on, command.led, False, tripped, cause, self.clock.now_s)

    def serve(
        self, until_s: float, wake: int | None = None, done: Callable[[], bool] = lambda: False
    ) -> None:
        self.clock.wait(None, wake, until_s)

    def serve_until_echo(self, timeout_s: float) -> Echo | None:
        return self.echo if self.confirms else None

    def serve_until_answered(self, timeout_s: float) -> bool:
        if self.link_up and self.confirms:
            self._say()
        return self.link_up and self.confirms

    @property
    def in_maintenance(self) -> bool:
        return self.maintained

    def emergency_stop(self) -> None:
        self.stops += 1
        self.stopped = True

    def release_stop(self) -> None:
        self.stopped = False

    def maintain(self) -> None:
        self.maintained = True

    def end_maintenance(self) -> None:
        self.maintained = False

    def clear_trip(self) -> None:
        self.cleared += 1
        self.tripped = self.tripped and self.keeps_trip

    def accept(self) -> tuple[bool, str]:
        accepted, self.foreign, self.link_up = bool(self.foreign), "", True
        return accepted, "Board 2 is this rig's." if accepted else "Nothing changed."


@dataclass
class Wants:
    """A controller that always wants the same."""

    name: str = "wants"
    command: Command = field(default_factory=lambda: Command(heater_duty=0.5))
    error: Exception | None = None
    hang_s: float = 0.0
    asked: int = 0
    resets: int = 0

    def decide(self, context: Context) -> Decision:
        self.asked += 1
        if self.error is not None:
            raise self.error
        time.sleep(self.hang_s)
        return Decision(self.command, self.name)

    def reset(self) -> None:
        self.resets += 1


@dataclass
class FakeSink:
    records: list[TickRecord] = field(default_factory=list)
    ill: dict[str, str] = field(default_factory=dict)

    def write(self, record: TickRecord) -> None:
        self.records.append(record)

    def faults(self) -> Mapping[str, str]:
        return self.ill


@dataclass
class LoopRig:
    """All the parts, and a loop that ticks when told."""

    clock: FakeClock = field(default_factory=FakeClock)
    chosen: Wants = field(default_factory=lambda: Wants("MPC"))
    fallback: Wants = field(default_factory=lambda: Wants("rules", Command(heater_duty=0.1)))
    sink: FakeSink = field(default_factory=FakeSink)
    inbox: Inbox = field(default_factory=Inbox)
    saved: list[Operation] = field(default_factory=list)
    save_answers: list[Answered] = field(default_factory=list)  # that wait for a disk
    disk_works: bool = True
    shown: list[Echo | None] = field(default_factory=list)
    settings: Settings = field(default_factory=config.default)
    boot_id: str = "boot"
    documents: tuple[str, str] | None = None  # as they are on the disk: standing orders, limits

    def __post_init__(self) -> None:
        self.board = FakeBoard(self.clock)
        self.settings = replace(
            self.settings,
            safety=replace(self.settings.safety, heater_rise_per_s=1.0),
            control=replace(self.settings.control, decision_deadline_s=0.1),
        )
        self._start(StandingState(Operation("MPC"), SafetyMemory()), None)

    def _start(self, state: StandingState, clocks: Moment | None) -> None:
        model = read_arx()
        control = self.settings.control
        rig = Rig(
            settings=self.settings,
            clock=self.clock,
            board=self.board,
            sensors=SensorHealth(
                self.settings.sensor_health, self.settings.calibration, air_doubt=state.memory.air_doubt
            ),
            estimator=Estimator(self.settings.estimator, model, control.step_s, control.ambient_default_c),
            reference=make_reference(self.settings.reference),
            zone=None,
            controllers={"MPC": self.chosen, "rules": self.fallback},
            models=NoForecasts(),
            sinks=[self.sink],
            more_events=list,
            inbox=self.inbox,
            save_state=self._save,
            show=lambda status: self.shown.append(status.echo),
            clocks=clocks,
            foreign_board=lambda: self.board.foreign,
            accept_board=self.board.accept,
        )
        self.rig = rig
        self.loop = Loop(rig, state.operation, state.memory, first_seq=1)

    def now(self) -> Moment:
        return Moment(self.boot_id, self.clock.now(), self.clock.utc())

    def kill(self, off_s: float = 5.0, jump_s: float = 0.0, boot_id: str = "boot") -> None:
        """Begin again from the documents on the disk. jump_s : of the wall clock while nothing ran"""
        utc = self.clock.utc() + off_s + jump_s
        self.clock.now_s = self.clock.now_s + off_s if boot_id == self.boot_id else 20.0
        self.clock.utc_offset, self.boot_id = utc - self.clock.now_s, boot_id
        self.board._sampled_s = self.clock.now_s - 1.0
        self.loop.close()
        state, limits = StandingState(Operation("MPC"), SafetyMemory()), ""
        if self.documents is not None:
            state = decode_standing(json.loads(self.documents[0]))
            limits = LIMITS.decode(json.loads(self.documents[1])) if self.documents[1] else "damaged"
        state = carry_on(state, limits, self.now(), self.rig.box.heater_w)
        self._start(state, state.at)

    def run(self, seconds: float) -> None:
        """Let the loop tick by itself for so long, from its start on; nothing is saved at the end."""
        self.loop._rig = replace(self.rig, stop_at_s=self.clock.now_s + seconds)
        self.loop._shut_down = lambda: None  # type: ignore[method-assign]
        self.loop.run()

    def tick(self, after_s: float = 60.0) -> TickRecord:
        """Let time pass, then tick."""
        self.clock.now_s += after_s
        return self.loop.tick(self.clock.now_s)

    def ask(self, request: Mapping[str, Any]) -> Reply:
        """The answer to a request that the disk takes; {} while it waits for the disk."""
        answers: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self.loop._answer(Letter(request, answers))
        return {} if answers.empty() else reply_json(answers.get())

    def _save(self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
        self.saved.append(operation)
        if self.disk_works:
            state = StandingState(operation, memory, at=self.now())
            self.documents = (json.dumps(encode_standing(state)), json.dumps(encode_limits(state)))
        if answered is not None:
            self.save_answers.append(answered)
            if self.disk_works:
                self.save_answers.pop()("")

    def events(self) -> list[str]:
        return [event.key for record in self.sink.records for event in record.events]

    def close(self) -> None:
        self.inbox.close()
        self.loop.close()


def is_safe(command: Command) -> bool:
    """Nothing that heats or waters."""
    return command.heater_duty == 0.0 and command.valve_pulse_s == 0.0 and not math.isnan(command.led)
