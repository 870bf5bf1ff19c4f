"""Parts of a loop: a board's line, sensors, models, controllers, and the sinks of records."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from typing import Protocol

from edge.config.settings import Settings
from edge.core.clock import Clock, Moment
from edge.core.controller import Columns, Controller
from edge.core.messages import (
    AirSensorPair,
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
from edge.safety.box_bounds import PAPER_BOX, BoxBounds
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
    air_pair: AirSensorPair | None

    @property
    def link_up(self) -> bool:
        """True while the board answers in our protocol version."""
        ...

    @property
    def in_maintenance(self) -> bool:
        """True while the board is off for maintenance, or has been ordered to be."""
        ...

    @property
    def has_samples(self) -> bool:
        """True while sensor reports wait for `take_samples`."""
        ...

    @property
    def statistics(self) -> Mapping[str, int]:
        """Counters of the line since the start; empty for a recording."""
        ...

    def take_samples(self) -> list[Mapping[str, Reading]]:
        """Return the sensor reports since the last call, oldest first, each by signal."""
        ...

    def take_events(self) -> list[Event]:
        """Return the events of port, link and board since the last call."""
        ...

    def drive(self, command: Command, cutoff_open: bool, step_s: float) -> None:
        """Hold `command` for `step_s` from now; `cutoff_open` breaks the heater's supply a second time."""
        ...

    def serve(
        self, until_s: float, wake: int | None = None, done: Callable[[], bool] = lambda: False
    ) -> None:
        """Keep the line alive until `until_s` [monotonic], a byte on descriptor `wake`, or `done()`."""
        ...

    def serve_until_echo(self, timeout_s: float) -> Echo | None:
        """Wait for the answer to the last command; None when it is late or the link is down."""
        ...

    def serve_until_answered(self, timeout_s: float) -> bool:
        """Wait for the answers to stops, releases and `clear_trip`; False when one is missing."""
        ...

    def emergency_stop(self) -> None:
        """Turn every output off and latch that on the board; without a link, once the link is up."""
        ...

    def release_stop(self) -> None:
        """End the emergency stop; the heater stays off until a command asks for heat."""
        ...

    def maintain(self) -> None:
        """Turn every output off under a latch of its own, which `release_stop` does not clear."""
        ...

    def end_maintenance(self) -> None:
        """End the latch of maintenance; an emergency stop stays."""
        ...

    def clear_trip(self) -> None:
        """Ask the board to clear its trip; refused while the air is too warm or unknown."""
        ...


class Models(Protocol):
    """The models as a loop needs them, twice a tick."""

    @property
    def twin(self) -> BoxTwin | None:
        """Active physics model, which the drift watch follows; None without one."""
        ...

    def exchange(self, estimator: Estimator, controllers: dict[str, Controller]) -> str:
        """Put newly served models into both arguments; return a description, "" without a change."""
        ...

    def begin_anew(self) -> None:
        """Score no forecast from before now: a sensor reads by another calibration."""
        ...

    def forecast(self, history: Columns, decision: Decision, driven: Command, confirmed: bool) -> Forecasts:
        """Return forecasts by model, and the skill so far; without `confirmed` no past forecast is scored."""
        ...


class NoForecasts:
    """The models of a loop that never exchanges them: a replay."""

    twin: BoxTwin | None = None

    def exchange(self, estimator: Estimator, controllers: dict[str, Controller]) -> str:
        """Nothing to exchange."""
        return ""

    def begin_anew(self) -> None:
        """Nothing is scored."""

    def forecast(self, history: Columns, decision: Decision, driven: Command, confirmed: bool) -> Forecasts:
        """None."""
        return {}, ()


class DriftWatch(Protocol):
    """Compare the running twin with the measurements, once a tick; never raises."""

    def tick(self, twin: BoxTwin | None, history: Columns, confirmed: bool, hands_in: bool = False) -> Drift:
        """Return the drift at the newest row; a row without `confirmed` or with `hands_in` is not judged."""
        ...

    def begin_anew(self) -> None:
        """Let the filter settle again: a sensor reads by another calibration. Evidence stays."""
        ...

    def take_events(self) -> list[Event]:
        """Return the starts and ends of alarms since the last call, and a failure of the watch itself."""
        ...


class SaveState(Protocol):
    """Keeps orders and trips for the next start; never waits. `answered` as in `StateWriter.save`."""

    def __call__(
        self, operation: Operation, memory: SafetyMemory, answered: Answered | None = None, /
    ) -> None:
        """Hand over the newest values; older ones that wait for the disk are dropped."""
        ...


class Sink(Protocol):
    """A destination of records. Never waits, never raises; its own faults come back as conditions."""

    def write(self, record: TickRecord) -> None:
        """Take one tick; a destination that can't keep up queues or drops it."""
        ...

    def faults(self) -> Mapping[str, str]:
        """Return key of the failure table -> detail, for each failure that holds now."""
        ...


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
    foreign_board: Callable[[], str] = lambda: ""  # ids of a board that answers and is not the pinned one
    accept_board: Callable[[], tuple[bool, str]] = lambda: (False, "")  # drive it; whether new, what holds
    drift: DriftWatch | None = None  # watches the running twin
    box: BoxBounds = PAPER_BOX
    clocks: Moment | None = None  # a joint reading, unless someone has set one since the previous process
