"""Looks at the rig and its history again and again, and enters into the book of alarms what it finds."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edge.config.alarm_settings import AlarmSettings
from edge.core.errors import DataError
from edge.page.access import Access
from edge.page.alarms.alarm_book import AlarmBook, EventPlace
from edge.page.alarms.alarm_events import HistoryEvent, events_after, newest_place
from edge.page.alarms.rig_watch import (
    OVER,
    STOP,
    STOP_TEXT,
    TRIPS,
    Finding,
    RigWatch,
    cause_of,
    has_end,
    is_seen,
)
from edge.page.answers import in_thread
from edge.page.rig_link import RigLink

LOOKS_MAX_S = 60.0  # without a whole look: then no sign of life is given
UNREAD_S = 60.0  # of a history that cannot be read, before that is an alarm
UNREAD = "history.unread"


@dataclass(frozen=True, slots=True)
class Clocks:
    """Times that a test sets by hand. utc : wall [s since 1970];  now : monotonic [s]"""

    utc: Callable[[], float] = time.time
    now: Callable[[], float] = time.monotonic


@dataclass(slots=True)
class AlarmWatch:
    """The one who looks. place : of the history, up to which it has been read; None for its end, at first"""

    settings: AlarmSettings
    history: Path
    access: Access
    rig: RigLink
    book: AlarmBook
    place: EventPlace | None
    clocks: Clocks
    _rig_watch: RigWatch = field(init=False)
    _looked_s: float = float("-inf")
    _read_s: float = field(init=False)  # when the history was read

    def __post_init__(self) -> None:
        self._rig_watch = RigWatch(self.settings.silent_s, self.clocks.now())
        self._read_s = self.clocks.now()

    async def look(self) -> None:
        """Look once. Errors: DataError where the page's own file cannot be read"""
        events, unread = await self._read_history()
        view, now_s, utc = self.rig.view(), self.clocks.now(), self.clocks.utc()
        findings = [*self._rig_watch.look(view, now_s), self._history_finding(unread, view["reached"])]
        enter(self.book, AlarmLook(utc, view, findings, events))
        await self._note_seen()
        self._looked_s = now_s

    def problem(self) -> str:
        """Return why no sign of life may be given, "" where all goes well."""
        now_s, view = self.clocks.now(), self.rig.view()
        if not view["reached"]:
            return "the daemon does not answer"
        if not self._rig_watch.is_alive(view, now_s):
            return "the daemon makes no ticks"
        return "" if now_s - self._looked_s <= LOOKS_MAX_S else "the page does not look for alarms"

    async def _read_history(self) -> tuple[list[HistoryEvent], str]:
        """Return new events, and why they cannot be read, "" where they can."""
        try:
            if self.place is None:
                self.place = await in_thread(newest_place, self.history)
            events, self.place = await in_thread(events_after, self.history, self.place)
        except DataError as error:
            return [], str(error)
        return events, ""

    def _history_finding(self, unread: str, reached: bool) -> Finding:
        now_s = self.clocks.now()
        if not unread:
            self._read_s = now_s
        # A daemon that has not run yet has no history, and is an alarm itself.
        holds = bool(unread) and reached and now_s - self._read_s > UNREAD_S
        text = f"the page cannot read the history, so its alarms do not reach you: {unread}"
        return Finding(UNREAD, True if holds else None if unread else False, text)

    async def _note_seen(self) -> None:
        """Note what was acknowledged as events; not words of before, as of a history that was another one."""
        alarms = [alarm for alarm in self.book.alarms.values() if alarm.places and not alarm.seen_by]
        if alarms:
            first_seq = min(place.seq for alarm in alarms for place in alarm.places)
            since_utc = min(alarm.begun_utc for alarm in alarms)
            self.book.note_seen(await in_thread(self.access.who_acknowledged, first_seq, since_utc))


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
