"""Inputs, memory and verdicts of the safety supervisor. All frozen; see edge/safety/supervisor.py."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from edge.core.hard_limits import LEASE_S
from edge.core.messages import Change, Command, Echo, Estimate, Event, Reading
from edge.safety.box_bounds import PAPER_BOX, BoxBounds
from edge.safety.thermal_supervision import ThermalMemory

HOUR_S = 3600.0
DAY_S = 86400.0
HEAT_BUCKET_S = 600.0  # heat is counted in pieces of ten minutes
RISE_OVER_S = 30.0  # a rate over less shows the sensor's steps: 0.1 K in 5 s are 1.2 K in a minute
HEAT_TELLS = 0.5  # a rise with less heat may be a lid that was shut
HOLDS_OVER_S = 600.0  # an open lid of a minute says little of what holds the air
RISE_GAP_S = 150.0  # after a longer time without a look there is no rate
RISE_MARGIN = 1.3  # above the fastest rise so far: mains and room differ, and losses fell into its step
RISE_FADES_S = 6 * HOUR_S  # time constant of the fastest rise: warm walls behind an open lid fade too


@dataclass(frozen=True, slots=True)
class AirDoubt:
    """A fall of the air that the box cannot have made. before_c : what the air had"""

    since_s: float
    words: str
    before_c: float


@dataclass(frozen=True, slots=True)
class SafetyView:
    """The world at the moment of a decision."""

    readings: Mapping[str, Reading]
    estimate: Estimate
    echo: Echo | None
    link_up: bool
    emergency_stop: bool
    maintenance: bool
    now_s: float
    utc: float
    dt_s: float  # how long the command will hold [s]
    box: BoxBounds = PAPER_BOX
    air_doubt: AirDoubt | None = None
    is_foreign: bool = False  # a board is at the port that is not the rig's


@dataclass(frozen=True, slots=True)
class Dose:
    """Water given once. `time_s` is None where only `utc` is known: in a state file."""

    time_s: float | None
    utc: float
    length_s: float

    def age_s(self, now_s: float, utc: float) -> float:
        """Return how long ago it was [s]; a clock set back makes it recent, never forgotten."""
        return utc - self.utc if self.time_s is None else now_s - self.time_s

    def is_recent(self, now_s: float, utc: float) -> bool:
        """Within the last 24 hours."""
        return not self.age_s(now_s, utc) >= DAY_S


@dataclass(frozen=True, slots=True)
class AirRise:
    """How fast the air was seen to rise: now, negative while it falls, and at most by full heat [K/s]."""

    time_s: float | None = None  # of the last look; None: without a good reading since
    air_c: float = 0.0
    highest_c: float = -math.inf  # of the last two looks, with the heat between: a lid may have hidden it
    rate_k_s: float = 0.0
    fastest_k_s: float = 0.0  # without what was lost meanwhile, which `holds` tells
    holds: float = 0.0  # mean heater duty that would have kept the air where it was


def follow_air(rise: AirRise, now_s: float, dt_s: float, temp_air: float | None, sent: float) -> AirRise:
    """Return the rise after one more look. temp_air : [°C]; None unless good; sent : duty since"""
    passed_s = math.inf if rise.time_s is None else now_s - rise.time_s
    if temp_air is None or not 0.0 <= passed_s <= max(RISE_GAP_S, 2.5 * dt_s):
        if temp_air is None:
            return AirRise(fastest_k_s=rise.fastest_k_s, holds=rise.holds)
        return AirRise(now_s, temp_air, temp_air, 0.0, rise.fastest_k_s, rise.holds)
    if passed_s < RISE_OVER_S:
        return rise
    rate_k_s = (temp_air - rise.air_c) / passed_s
    lost_k_s = rise.holds * rise.fastest_k_s
    by_heat_k_s = (rate_k_s + lost_k_s) / (sent if sent >= HEAT_TELLS else 1.0)
    fastest_k_s = max(by_heat_k_s, rise.fastest_k_s * math.exp(-passed_s / RISE_FADES_S))
    without_lid_c = rise.air_c + (RISE_MARGIN * sent - rise.holds) * rise.fastest_k_s * passed_s
    held = min(max(sent - rate_k_s / fastest_k_s, 0.0), 1.0) if fastest_k_s > 0.0 else 0.0
    holds = rise.holds + (held - rise.holds) * -math.expm1(-passed_s / HOLDS_OVER_S)
    return AirRise(now_s, temp_air, max(temp_air, without_lid_c), rate_k_s, fastest_k_s, holds)


@dataclass(frozen=True, slots=True)
class SafetyMemory:
    """All that safety keeps from one decision to the next."""

    trips: tuple[str, ...] = ()  # latched, in the order of their coming
    sent: Command = field(default_factory=Command)
    heater_ramp: float = 0.0  # heater duty allowed by the slew limit, before it is cut to a level
    time_s: float | None = None  # of the last decision
    fan_since_s: float | None = None  # when the fan was last switched; None: not since the start
    fan_switches: tuple[float, ...] = ()  # times of the last hour's [s]
    heat: tuple[tuple[float, float], ...] = ()  # begin of a piece [s], heat in it [Wh]; the last 24 hours
    doses: tuple[Dose, ...] = ()
    releases_until_s: float = 0.0  # each end of a stop moves it on; how far it may lie ahead is bounded
    thermal: ThermalMemory = field(default_factory=ThermalMemory)
    rise: AirRise = AirRise()
    air_doubt: AirDoubt | None = None


@dataclass(frozen=True, slots=True)
class SafetyVerdict:
    """The command that may be sent, and why it differs from the wanted one."""

    sent: Command
    changes: tuple[Change, ...]
    memory: SafetyMemory
    events: tuple[Event, ...]
    open_cutoff: bool  # open the second cut-off in the heater's supply, where the board has one


def elapsed_s(memory: SafetyMemory, now_s: float, dt_s: float) -> float:
    """Time the last command has really held: not longer than its lease, not negative [s]."""
    if memory.time_s is None:
        return 0.0
    return max(0.0, min(now_s - memory.time_s, dt_s + LEASE_S))


def book_heat(memory: SafetyMemory, now_s: float, dt_s: float, heater_w: float) -> SafetyMemory:
    """Add the heat of the command that has held until now, as if the heater gave its full rated power."""
    added = memory.sent.heater_duty * heater_w * elapsed_s(memory, now_s, dt_s) / HOUR_S
    heat = tuple(piece for piece in memory.heat if now_s - piece[0] < DAY_S)
    if heat and now_s - heat[-1][0] < HEAT_BUCKET_S:
        heat = (*heat[:-1], (heat[-1][0], heat[-1][1] + added))
    elif added > 0.0:
        heat = (*heat, (now_s, added))
    return replace(memory, heat=heat)


def heat_wh(memory: SafetyMemory, now_s: float, window_s: float) -> float:
    """Heat of the pieces that began within the last `window_s` [Wh]."""
    return sum(wh for begin_s, wh in memory.heat if now_s - begin_s < window_s)


def water_s(memory: SafetyMemory, now_s: float, utc: float) -> float:
    """Valve time of the last 24 hours [s]."""
    return sum(dose.length_s for dose in memory.doses if dose.is_recent(now_s, utc))


def remember(memory: SafetyMemory, sent: Command, ramp: float, view: SafetyView) -> SafetyMemory:
    """Return the memory after `sent` went out."""
    doses = tuple(dose for dose in memory.doses if dose.is_recent(view.now_s, view.utc))
    if sent.valve_pulse_s > 0.0:
        doses = (*doses, Dose(view.now_s, view.utc, sent.valve_pulse_s))
    switched = _fan_switches(memory.sent, sent, view)
    return replace(
        memory,
        sent=sent,
        heater_ramp=ramp,
        time_s=view.now_s,
        fan_since_s=switched[-1] if switched else memory.fan_since_s,
        fan_switches=(*(at for at in memory.fan_switches if view.now_s - at < HOUR_S), *switched),
        doses=doses,
        air_doubt=view.air_doubt,
    )


def _fan_switches(before: Command, sent: Command, view: SafetyView) -> tuple[float, ...]:
    """Return when the relay switches in the step that begins now [s]."""
    at = (view.now_s,) if sent.fan_on != before.fan_at_end else ()
    return (*at, view.now_s + sent.fan * view.dt_s) if sent.fan_on and not sent.fan_at_end else at


def survives_as(memory: SafetyMemory, other: SafetyMemory) -> bool:
    """Return True where both leave the same behind for the next process, but for minutes of heat."""
    left = [(m.trips, m.doses, m.air_doubt, m.heat[-1][0] if m.heat else None) for m in (memory, other)]
    return left[0] == left[1]
