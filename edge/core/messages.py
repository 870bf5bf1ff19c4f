"""The values that travel down the line of one tick. All frozen; time is always given, never asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from edge.core.plain_text import plain

EVENT_TEXT_MAX = 1000  # characters: a rationale's claims, and an exception of any library


class ReadingQuality(Enum):
    """How far a number can be trusted. Only GOOD ones reach a controller or allow heating."""

    GOOD = "good"
    STALE = "stale"  # no sample within 3 sample periods
    RANGE = "range"  # outside the datasheet range
    SPIKE = "spike"  # a jump no greenhouse can make
    STUCK = "stuck"  # does not move while the box must
    FAULT = "fault"  # the board reported an error
    ABSENT = "absent"  # this board has no such sensor


@dataclass(frozen=True, slots=True)
class Reading:
    """One raw sample of one signal."""

    signal: str  # a key of edge.core.names.SIGNALS
    value: float | None  # in the signal's unit; None when there is no number
    time_s: float  # host monotonic time of the sample
    quality: ReadingQuality


@dataclass(frozen=True, slots=True)
class AirSensorPair:
    """Two air sensors of one board as they last showed [°C], None for one that is not good."""

    first: float | None
    second: float | None
    are_apart: bool  # by more than the board's limit

    @property
    def is_alone(self) -> bool:
        """Only one of the two is good."""
        return (self.first is None) != (self.second is None)


@dataclass(frozen=True, slots=True)
class Command:
    """A command to the actuators. The default is the safe one: everything off."""

    heater_duty: float = 0.0  # 0..1 in steps of 1/20
    fan_on: bool = False
    led: float = 0.0  # 0..1
    valve_pulse_s: float = 0.0  # one pulse, given once [s]
    fan_share: float = 1.0  # part of the step, from its beginning, in which the fan is on, if it is on at all

    @property
    def fan(self) -> float:
        """Share of the step in which the fan is on, 0..1."""
        return self.fan_share if self.fan_on else 0.0

    @property
    def fan_at_end(self) -> bool:
        """True where the fan is still on when the step ends."""
        return self.fan >= 1.0


@dataclass(frozen=True, slots=True)
class Change:
    """One rule's reason why a command that was wanted was not sent as it was."""

    rule: str  # stable id, e.g. "heater.over_temperature"
    actuator: str  # a key of edge.core.names.ACTUATORS
    wanted: float
    sent: float
    reason: str


class Severity(Enum):
    """How an event is shown."""

    INFO = "info"
    WARNING = "warning"
    ALARM = "alarm"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, once. `key` is stable, `text` is one line for people."""

    key: str  # e.g. "board.link_lost"
    severity: Severity
    text: str
    time_s: float
    utc: float  # [s since 1970]

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", plain(self.text, EVENT_TEXT_MAX))


@dataclass(frozen=True, slots=True)
class Estimate:
    """Filtered state: what the models start from."""

    temp_air: float  # [°C]; NaN before the first good measurement
    temp_air_sd: float  # standard deviation [K]
    offset: float  # disturbance: what the model misses per step [K/step]
    innovation: float | None  # measured minus predicted at this tick [K]; None without a measurement
    temp_ambient: float  # last good value, else the configured default [°C]
    time_s: float  # time of the last good air temperature; -inf before the first


@dataclass(frozen=True, slots=True)
class Decision:
    """A controller's wanted command, and its reason."""

    command: Command
    controller: str  # public name, e.g. "MPC-P"
    forecast: tuple[float, ...] = ()  # air temperature after each of the next steps [°C]
    why: Mapping[str, Any] = field(default_factory=dict)  # JSON values only
    plan: tuple[tuple[float, float], ...] = ()  # heater duty and fan of each of the next steps; not stored


@dataclass(frozen=True, slots=True)
class Forecast:
    """One predictor's forecast under the planned inputs, by horizon in minutes."""

    temps: Mapping[int, float] = field(default_factory=dict)  # [°C]; empty where there is none
    half_widths: Mapping[int, float] = field(default_factory=dict)  # of the interval, where calibrated [K]
    outside: bool | None = None  # beyond what the predictor was trained on; None: it does not know
    reason: str = ""  # why there is none


@dataclass(frozen=True, slots=True)
class ForecastSkill:
    """How one predictor has done at one horizon, the newest day counting most."""

    predictor: str
    version: str
    horizon_min: int
    scored: int  # forecasts that met their measurement, in all
    mae_k: float  # mean absolute error
    against_persistence: float | None  # 1 - MAE / MAE of the reference on the same forecasts
    against_pbm: float | None  # None for the PBM itself, and where there is none
    half_width_k: float | None  # of the interval now; None where not calibrated
    covered: float | None  # share of the measurements that were inside


class DriftState(Enum):
    """The drift monitor's verdicts on the running twin."""

    AGREES = "agrees"
    DISAGREES = "disagrees"  # until it was seen to agree again
    UNKNOWN = "unknown"  # not judged at this tick


@dataclass(frozen=True, slots=True)
class DriftRow:
    """How the twin did lately in one regime."""

    ticks: float  # the newest hour counting most
    share_of_squares: float  # of its squared innovations in all regimes
    error_k: float  # measured minus predicted one step ahead, mean


@dataclass(frozen=True, slots=True)
class Drift:
    """The agreement of the running twin with the greenhouse."""

    state: DriftState = DriftState.UNKNOWN
    text: str = ""  # for people
    reason: str = ""  # why it is not judged
    since_utc: float | None = None  # since when it disagrees
    where: str = "all"  # regime in which it errs most, a name of edge/drift/regimes.py
    error_k: float = 0.0  # there
    evidence: float = 0.0  # log of the sum over log of its threshold: 1 raises the alarm
    learnt: float = 0.0  # share of what is to be learnt of its ordinary errors
    regimes: Mapping[str, DriftRow] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Echo:
    """The outputs that the board reports."""

    heater_duty: float
    fan_on: bool
    led: float
    valve_open: bool
    tripped: bool
    trip_cause: str  # "" when not tripped
    time_s: float  # when it was received
    fan_share: float = 1.0  # of the step, as ordered, where the fan is on

    @property
    def fan(self) -> float:
        """Share of the step in which the fan is on, 0..1."""
        return self.fan_share if self.fan_on else 0.0

    @property
    def stopped(self) -> bool:
        """The board drives nothing until a person ends it: hands may be in the greenhouse."""
        return self.trip_cause in ("emergency_stop", "maintenance", "storage_damaged")

    def drives_as(self, other: "Echo | None") -> bool:
        """Return whether both report the same pins and the same trip."""
        return other is not None and replace(self, time_s=other.time_s) == other


@dataclass(frozen=True, slots=True)
class TickRecord:
    """All of one tick: written to the history, published, shown."""

    seq: int
    time_s: float
    utc: float  # start of the tick [s since 1970]
    step_s: float
    mode: str  # operator mode: "auto", "manual", "off", "fan_only", "heat"; "emergency_stop" overrides
    readings: Mapping[str, Reading]
    estimate: Estimate
    reference_c: float  # target for the end of this step
    decision: Decision
    wanted: Command  # after the operator's mode, before safety
    changes: tuple[Change, ...]
    sent: Command
    echo: Echo | None  # None when the board did not acknowledge in time
    link_up: bool
    events: tuple[Event, ...]
    ticks_skipped: int  # ticks lost before this one (host suspended, overloaded)
    late_s: float  # how late this tick began [s]
    decide_ms: float  # wall time of the decision
    forecasts: Mapping[str, Forecast] = field(default_factory=dict)  # by predictor
    skill: tuple[ForecastSkill, ...] = ()  # so far, not of this tick alone: the history keeps one an hour
    drift: Drift | None = None  # None where it is not watched; the history keeps its events alone
