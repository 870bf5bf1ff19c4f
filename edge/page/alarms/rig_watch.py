"""Alarms that the page itself notices in what it sees of the rig; values alone, handed the time.

The daemon writes no event while it hangs, and a history on a full disk takes none. So the page looks at the
daemon's last answer itself: daemon, ticks, board, stop, trips and the air's sensor.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from edge.core.plain_text import plain
from edge.tick.faults import FAILURES

DAEMON, TICKS, BOARD, STOP, BOARD_TRIP = (
    "daemon.silent",
    "daemon.no_ticks",
    "board.silent",
    "emergency_stop",
    "board.tripped",
)
STOP_TEXT = "the emergency stop is pressed: everything is off until it is released"
AIR, TRIPS = "reading.not_good", "safety."
HOLD_S = 10.0  # of what may be over by itself at the next look
STEPS_MAX = 3.0  # without a tick: the daemon's own watchdog restarts it after 2.5
OVER = ".over"
_BOARD_EVENTS = (
    *("board.link_lost", "board.link_down", "board.port_missing", "board.unplugged", "board.version"),
)
_SEEN = (DAEMON, TICKS, BOARD, STOP, BOARD_TRIP, AIR)  # in a view, with their end


@dataclass(frozen=True, slots=True)
class Finding:
    """An alarm's cause, and whether it holds: None where nobody can say."""

    cause: str
    holds: bool | None
    text: str = ""


@dataclass(slots=True)
class RigWatch:
    """Looks at one view of the rig after the other.

    silent_s : a daemon or its ticks may be silent so long;  begun_s : when the page began to look [s]
    """

    silent_s: float
    begun_s: float
    _since: dict[str, float] = field(default_factory=dict)
    _seq: int | None = None
    _advanced_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._advanced_s = self.begun_s

    def look(self, view: Mapping[str, Any], now_s: float) -> list[Finding]:
        """Return what a view says of each cause. view : of `RigLink`; now_s : monotonic [s]"""
        self._note_tick(view, now_s)
        status = view["status"] if view["reached"] else None
        findings = [self._daemon(view, now_s), self._ticks(status, now_s), _stop(view, status)]
        if status is not None:
            findings += _board(status)
            findings += [
                Finding(
                    f"{TRIPS}{trip}", True, f"safety has tripped: {plain(str(trip))}; no heat until reset"
                )
                for trip in status["trips"]
            ]
        return [self._lasting(one, now_s) for one in findings]

    def is_alive(self, view: Mapping[str, Any], now_s: float) -> bool:
        """Return whether the daemon has answered the last question and goes on making ticks."""
        status = view["status"]
        return bool(view["reached"] and status["tick"]) and now_s - self._advanced_s <= self._ticks_s(status)

    def _note_tick(self, view: Mapping[str, Any], now_s: float) -> None:
        tick = (view["status"] or {}).get("tick") if view["reached"] else None
        if tick is not None and tick["seq"] != self._seq:
            self._seq, self._advanced_s = tick["seq"], now_s

    def _ticks_s(self, status: Mapping[str, Any]) -> float:
        tick = status["tick"]
        return max(self.silent_s, STEPS_MAX * tick["step_s"] if tick else 0.0)

    def _daemon(self, view: Mapping[str, Any], now_s: float) -> Finding:
        if view["reached"]:
            return Finding(DAEMON, False)
        silent_s = now_s - self.begun_s if view["silent_s"] is None else view["silent_s"]
        text = (
            f"the daemon has not answered for {silent_s:.0f} s; the board turns everything off by itself "
            f"{view['lease_s']:g} s after the daemon's last word ({plain(view['error'])})"
        )
        return Finding(DAEMON, True if silent_s > self.silent_s else None, text)

    def _ticks(self, status: Mapping[str, Any] | None, now_s: float) -> Finding:
        if status is None:
            return Finding(TICKS, None)
        still_s = min(now_s - self._advanced_s, status["since_start_s"])  # a new daemon has its time, too
        text = f"the daemon answers, but it has made no tick for {still_s:.0f} s"
        return Finding(TICKS, still_s > self._ticks_s(status), text)

    def _lasting(self, one: Finding, now_s: float) -> Finding:
        """Return a finding as unknown until it has held for HOLD_S, where a moment of it is no alarm."""
        if one.cause not in (BOARD, AIR) or not one.holds:
            self._since.pop(one.cause, None)
            return one
        since_s = self._since.setdefault(one.cause, now_s)
        return one if now_s - since_s >= HOLD_S else Finding(one.cause, None)


def _stop(view: Mapping[str, Any], status: Mapping[str, Any] | None) -> Finding:
    if waits := view["stop_waits"]:
        text = f"a stop by {plain(str(waits['by']))} waits for the daemon, which does not answer"
        return Finding(STOP, True, text)
    if status is None:
        return Finding(STOP, None)
    by_board = (status["echo"] or {}).get("trip_cause") == STOP
    return Finding(STOP, by_board or bool(status["operation"]["emergency_stop"]), STOP_TEXT)


def _board(status: Mapping[str, Any]) -> Iterator[Finding]:
    silent = not status["link_up"] and not status.get("foreign_board")  # a foreign board has a separate event
    yield Finding(BOARD, silent, "the board is silent; it turns its heater off by itself")
    echo = status["echo"]
    if echo is not None:
        # Maintenance is wanted, and the emergency stop is an alarm of its own.
        holds = bool(echo["tripped"]) and echo["trip_cause"] not in ("maintenance", "emergency_stop")
        yield Finding(BOARD_TRIP, holds, f"the board has tripped: {plain(str(echo['trip_cause']))}")
    if tick := status["tick"]:
        air = tick["readings"].get("temp_air_c") or {"quality": "absent"}
        text = f"the air temperature is not good: {plain(str(air['quality']))}; the heater is off"
        yield Finding(AIR, air["quality"] != "good", text)


def cause_of(key: str, text: str) -> str:
    """Return an event's cause: one for all that is said of a silent board, and of a pressed stop."""
    if key in _BOARD_EVENTS:
        return BOARD
    if key == BOARD_TRIP and text.endswith(STOP):
        return STOP
    return key


def has_end(cause: str) -> bool:
    """Return whether a view or a later event says when an alarm of this cause is over."""
    return cause in _SEEN or cause.startswith(TRIPS) or cause in FAILURES


def is_seen(cause: str) -> bool:
    """Return whether views say of a cause that it is over, so that its events need not."""
    return cause in _SEEN or cause.startswith(TRIPS)
