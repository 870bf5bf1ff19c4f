"""One look at the rig and its history, entered into the book of alarms; values alone, handed the time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from edge.page.alarms.alarm_book import AlarmBook
from edge.page.alarms.alarm_events import HistoryEvent
from edge.page.alarms.rig_watch import OVER, STOP, STOP_TEXT, TRIPS, Finding, cause_of, has_end, is_seen

RESTART_S = 180.0  # after which a new daemon has said again what still holds


@dataclass(frozen=True, slots=True)
class AlarmLook:
    """All that one look has found. utc : [s since 1970]"""

    utc: float
    view: Mapping[str, Any]
    findings: Iterable[Finding]
    events: Iterable[HistoryEvent] = ()


def enter(book: AlarmBook, look: AlarmLook) -> None:
    """Begin and end alarms as a look says. Events come first: what they begin may be over already."""
    for event in look.events:
        _enter_event(book, event, look.utc)
    holding = set()
    for finding in look.findings:
        if finding.holds:
            holding.add(finding.cause)
            book.begin(finding.cause, finding.text, look.utc)
        elif finding.holds is False:
            book.end(finding.cause, look.utc)
    if look.view["reached"]:
        _end_unsaid(book, look, holding)


def _enter_event(book: AlarmBook, event: HistoryEvent, utc: float) -> None:
    # A time that is no number, as of a daemon whose clock failed, is that of the look.
    event_utc = utc if event.utc is None else event.utc
    if event.is_alarm:
        cause = cause_of(event.key, event.text)
        text = STOP_TEXT if cause == STOP else event.text  # the history says no more than "emergency_stop"
        book.begin(cause, text, event_utc, event.place, has_end(cause))
    elif event.key.endswith(OVER) and not is_seen(cause := event.key.removesuffix(OVER)):
        book.end(cause, event_utc)


def _end_unsaid(book: AlarmBook, look: AlarmLook, holding: set[str]) -> None:
    """End trips that the daemon does not name any more, and what a daemon before this one has begun."""
    status = look.view["status"]
    started_utc = look.utc - status["since_start_s"]
    for cause, alarm in book.open_causes().items():
        is_cleared = cause.startswith(TRIPS) and cause not in holding
        is_unsaid = not is_seen(cause) and alarm.last_utc < started_utc
        if is_cleared or (
            alarm.lasts and has_end(cause) and is_unsaid and status["since_start_s"] > RESTART_S
        ):
            book.end(cause, look.utc)
