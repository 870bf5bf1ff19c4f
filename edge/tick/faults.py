"""Failure table: the reaction to each failure; and conditions that last, with one event at each end.

The loop, the history and the tests use these rows only.
"""

from dataclasses import dataclass

from edge.core.messages import Event, Severity


@dataclass(frozen=True, slots=True)
class Failure:
    """One thing that can go wrong while the daemon runs, and the answer it gets."""

    key: str  # event key while it lasts; `<key>.over` when it ends
    severity: Severity
    what: str
    answer: str


_ROWS = (
    Failure(
        "reading.not_good",
        Severity.ALARM,
        "the air temperature is not good",
        "heater off, the estimate goes on by model alone",
    ),
    Failure(
        "air.jump_contradicted",
        Severity.ALARM,
        "the air fell at once as no box can",
        "heat is at most what held it, none after 10 minutes, until air and room agree again, or a person "
        "accepts the value by `greenhouse clear-trip`; look at the sensor and its plug",
    ),
    Failure(
        "heater.unknown_power",
        Severity.ALARM,
        "the heater's power is not known",
        "no heat until `greenhouse setup`, or a line such as `box: {heater_w: 100}` in edge.yaml, names it",
    ),
    Failure(
        "air_sensors.apart",
        Severity.WARNING,
        "the two air sensors disagree",
        "the warmer counts; the one nearer to the model's forecast is named",
    ),
    Failure(
        "air_sensors.alone",
        Severity.WARNING,
        "one of the two air sensors is not good",
        "the other one counts alone",
    ),
    Failure(
        "estimate.old",
        Severity.ALARM,
        "the estimate is too old to plan from",
        "no controller is asked, the safe command is sent",
    ),
    Failure("controller.raised", Severity.WARNING, "the controller raised", "the fallback decides this step"),
    Failure(
        "controller.not_a_number",
        Severity.WARNING,
        "the controller gave no number",
        "the fallback decides this step",
    ),
    Failure("controller.late", Severity.WARNING, "the controller is late", "the fallback decides this step"),
    Failure("fallback.failed", Severity.ALARM, "the fallback failed too", "the safe command is sent"),
    Failure(
        "board.link_down",
        Severity.ALARM,
        "no word from the board",
        "nothing is sent; the board's lease ends and it turns the heater off; it is greeted until it answers",
    ),
    Failure(
        "board.foreign",
        Severity.ALARM,
        "another board is at the port",
        "it gets no command and no lease of its heater until `greenhouse board accept`",
    ),
    Failure(
        "board.no_echo",
        Severity.WARNING,
        "the board did not confirm the command",
        "the next renewal asks again; until it answers the heater counts as off",
    ),
    Failure(
        "tick.late",
        Severity.WARNING,
        "a tick began late",
        "the tick runs, the next one keeps to the grid, ticks that were missed are counted",
    ),
    Failure(
        "clock.jumped",
        Severity.WARNING,
        "the wall clock jumped",
        "control goes on by the monotonic clock; daily schedules follow the new time",
    ),
    Failure(
        "history.behind",
        Severity.WARNING,
        "the history database takes nothing (full, locked)",
        "rows wait in a bounded queue, what does not fit is counted, control goes on",
    ),
    Failure(
        "history.replaced",
        Severity.ALARM,
        "the history database was corrupt or gone",
        "it is set aside, a new one is begun, control goes on",
    ),
    Failure(
        "telemetry.offline",
        Severity.WARNING,
        "the broker is gone",
        "messages wait in the outbox on disk and are sent in order when it is back",
    ),
    Failure(
        "telemetry.name_taken",
        Severity.ALARM,
        "another client uses the name of this rig and evicts it from the broker, or seems to",
        "it connects again after a minute, the control socket works; give each rig a separate mqtt.rig",
    ),
    Failure(
        "telemetry.flooded",
        Severity.WARNING,
        "more commands come over MQTT than are carried out",
        "stop and maintenance have connections of their own, others are refused and counted",
    ),
    Failure(
        "state.unwritten",
        Severity.WARNING,
        "standing orders could not be saved",
        "who gave them is told; they hold until a restart; the file is tried again every 10 s",
    ),
    Failure(
        "bundle.refused",
        Severity.WARNING,
        "a bundle of models can't be used",
        "the one before it serves, else the packaged one",
    ),
    Failure(
        "output.behind",
        Severity.WARNING,
        "standard output takes no lines",
        "lines are counted and left out, control goes on",
    ),
    Failure(
        "state.broken",
        Severity.ALARM,
        "the state file can't be read at start",
        "the rig starts in emergency stop until a person releases it",
    ),
)

FAILURES: dict[str, Failure] = {row.key: row for row in _ROWS}


class Conditions:
    """Which rows of the failure table hold now."""

    def __init__(self) -> None:
        self._since: dict[str, float] = {}
        self._events: list[Event] = []

    def set(self, key: str, holds: bool, time_s: float, utc: float, detail: str = "") -> None:
        """Say whether `key` of the failure table holds at this tick. Errors: KeyError for an unknown key."""
        failure = FAILURES[key]
        if holds and key not in self._since:
            self._since[key] = time_s
            text = f"{failure.what}{f': {detail}' if detail else ''}; {failure.answer}"
            self._events.append(Event(key, failure.severity, text, time_s, utc))
        elif not holds and key in self._since:
            lasted_s = time_s - self._since.pop(key)
            text = f"over after {lasted_s:.0f} s: {failure.what}"
            self._events.append(Event(f"{key}.over", Severity.INFO, text, time_s, utc))

    def holds(self, key: str) -> bool:
        """Return whether `key` holds since an earlier `set`."""
        return key in self._since

    def standing(self) -> tuple[str, ...]:
        """Keys that hold now, the oldest first."""
        return tuple(self._since)

    def take_events(self) -> list[Event]:
        """Beginnings and ends since the last call."""
        events, self._events = self._events, []
        return events
