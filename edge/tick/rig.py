"""Parts of a loop: a board's line, sensors, models, controllers, and the sinks of records."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from typing import Protocol

from edge.config.settings import Settings
from edge.core.clock import Clock
from edge.core.controller import Columns, Controller
from edge.core.messages import (
    Command,
    Decision,
    Drift,
    Echo,
    Event,
    Forecast,
    ForecastSkill,
    Reading,
    TickRecord,
)
from edge.safety.supervisor import SafetyMemory
from edge.tick.estimator import Estimator
from edge.tick.inbox import Inbox
from edge.tick.orders import Operation
from edge.tick.reference import Reference
from edge.tick.sensor_health import SensorHealth
from edge.tick.status import LoopStatus
from edge.twin.model import BoxTwin

Answered = Callable[[str], None]  # called with "" when a value is on disk, else with the reason
Forecasts = tuple[dict[str, Forecast], tuple[ForecastSkill, ...]]


class BoardLine(Protocol):
    """The board as a tick needs it, real or recorded."""

    echo: Echo | None

    @property
    def link_up(self) -> bool: ...
    @property
    def in_maintenance(self) -> bool: ...
    @property
    def has_samples(self) -> bool: ...
    @property
    def statistics(self) -> Mapping[str, int]: ...  # counters of the line
    def take_samples(self) -> list[Mapping[str, Reading]]: ...
    def take_events(self) -> list[Event]: ...
    def drive(self, command: Command, cutoff_open: bool, valid_s: float) -> None: ...
    def serve(
        self, until_s: float, wake: int | None = None, done: Callable[[], bool] = lambda: False
    ) -> None: ...
    def serve_until_echo(self, timeout_s: float) -> Echo | None: ...
    def serve_until_answered(self, timeout_s: float) -> bool: ...
    def emergency_stop(self) -> None: ...
    def release_stop(self) -> None: ...
    def maintain(self) -> None: ...
    def end_maintenance(self) -> None: ...
    def clear_trip(self) -> None: ...


class Models(Protocol):
    """The models as a loop needs them, twice a tick."""

    @property
    def twin(self) -> BoxTwin | None: ...
    def exchange(self, estimator: Estimator, controllers: dict[str, Controller]) -> str: ...
    def forecast(
        self, history: Columns, decision: Decision, driven: Command, confirmed: bool
    ) -> Forecasts: ...


class NoForecasts:
    """The models of a loop that never exchanges them: a replay."""

    twin: BoxTwin | None = None

    def exchange(self, estimator: Estimator, controllers: dict[str, Controller]) -> str:
        """Nothing to exchange."""
        return ""

    def forecast(self, history: Columns, decision: Decision, driven: Command, confirmed: bool) -> Forecasts:
        """None."""
        return {}, ()


class DriftWatch(Protocol):
    """Compare the running twin with the measurements, once a tick; never raises."""

    def tick(
        self, twin: BoxTwin | None, history: Columns, confirmed: bool, hands_in: bool = False
    ) -> Drift: ...
    def take_events(self) -> list[Event]: ...


class SaveState(Protocol):
    """Keeps orders and trips for the next start; never waits. `answered` as in `StateWriter.save`."""

    def __call__(
        self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None, /
    ) -> None: ...


class Sink(Protocol):
    """A destination of records. Never waits, never raises; its own faults come back as conditions."""

    def write(self, record: TickRecord) -> None: ...
    def faults(self) -> Mapping[str, str]: ...  # key of the failure table -> detail, for each that holds now


@dataclass(frozen=True, slots=True)
class Rig:
    """All that a loop is wired to."""

    settings: Settings
    clock: Clock
    board: BoardLine
    sensors: SensorHealth
    estimator: Estimator
    reference: Reference
    zone: tzinfo | None
    controllers: dict[str, Controller]
    models: Models
    sinks: Sequence[Sink]
    more_events: Callable[[], list[Event]]  # of parts that are not asked each tick: the history's own
    inbox: Inbox
    save_state: SaveState
    after_tick: Callable[[TickRecord], None] = lambda record: None  # watchdog, display
    show: Callable[[LoopStatus], None] = lambda status: None  # publish a tick, or what changed between two
    stop_at_s: float = math.inf  # end of an experiment
    drift: DriftWatch | None = None  # watches the running twin
