"""One message about alarms: a title, a text of few lines, and the same as JSON for programs."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from edge.core.plain_text import plain
from edge.page.alarms.alarm_book import DueAlarms, RigAlarm

TITLE_MAX, LINE_MAX = 120, 300  # characters
NAMES_MAX = 10  # alarms that one message names
TEXT_BYTES = 3500  # ntfy makes a file of a text of over 4096 bytes
ALARM, REPEAT, OVER, TEST = "alarm", "repeat", "over", "test"


@dataclass(frozen=True, slots=True)
class AlarmMessage:
    """All that a channel sends. title : one line;  page : the page's address;  kind : of its gravest part"""

    kind: str
    title: str
    text: str
    page: str
    document: dict[str, Any] = field(default_factory=dict)


def message_of(due: DueAlarms, rig: str, page: str, utc: float, repeats: bool = True) -> AlarmMessage:
    """Return the message that names all that is due. repeats : it comes again until it is acknowledged"""
    kind = ALARM if due.new else REPEAT if due.still else OVER
    title = _title(due.new or due.still or due.over, rig, kind == OVER)
    hint = "Repeated until it is over, or acknowledged on the page.\n" if repeats and kind != OVER else ""
    text = f"{_fit(list(_lines(due)))}\n\n{hint}{rig}: {page}"
    return AlarmMessage(
        kind, title, text, page, _document(kind, title, rig, page, utc) | {"alarms": _json(due)}
    )


def trial_message(rig: str, page: str, utc: float) -> AlarmMessage:
    """Return a message that says that the channel works."""
    title = f"{rig}: a test, no alarm"
    text = f"{moment(utc)}: a test of the alarms of {rig}. Nothing is wrong.\n\n{rig}: {page}"
    return AlarmMessage(TEST, title, text, page, _document(TEST, title, rig, page, utc) | {"alarms": []})


def moment(utc: float) -> str:
    """Return a time as this machine's wall clock shows it."""
    return time.strftime("%Y-%m-%d %H:%M %Z", time.localtime(utc))


def _title(alarms: tuple[RigAlarm, ...], rig: str, are_over: bool) -> str:
    many = f"{len(alarms)} alarms{' are over' if are_over else ''}, one of them: " if len(alarms) > 1 else ""
    over = "over: " if are_over and not many else ""
    # "=?" begins an encoded word, which could hide a line end from whoever writes a header.
    return plain(f"{rig}: {over}{many}{alarms[0].text}".replace("=?", "= ?"), TITLE_MAX)


def _lines(due: DueAlarms) -> Iterator[str]:
    for alarm in due.new:
        yield f"ALARM since {moment(alarm.begun_utc)}: {_words(alarm)}"
    for alarm in due.still:
        yield f"Still, since {moment(alarm.begun_utc)}: {_words(alarm)}"
    for alarm in due.over:
        end = moment(alarm.begun_utc if alarm.over_utc is None else alarm.over_utc)
        yield f"Over since {end}, began {moment(alarm.begun_utc)}: {_words(alarm)}"


def _words(alarm: RigAlarm) -> str:
    times = f" ({alarm.times} times)" if alarm.times > 1 else ""
    return f"{plain(alarm.text, LINE_MAX)}{times}"


def _fit(lines: list[str]) -> str:
    """Return as many lines as a message holds, and the number of the others."""
    most = min(len(lines), NAMES_MAX)
    while most > 1 and len("\n".join(lines[:most]).encode()) > TEXT_BYTES:
        most -= 1
    more = len(lines) - most
    return "\n".join(lines[:most]) + (f"\nand {more} more: see the page" if more else "")


def _document(kind: str, title: str, rig: str, page: str, utc: float) -> dict[str, Any]:
    return {"kind": kind, "rig": rig, "title": title, "utc": round(utc, 3), "page": page}


def _json(due: DueAlarms) -> list[dict[str, Any]]:
    parts = ((ALARM, due.new), (REPEAT, due.still), (OVER, due.over))
    return [alarm_json(alarm) | {"state": state} for state, alarms in parts for alarm in alarms]


def alarm_json(alarm: RigAlarm) -> dict[str, Any]:
    """Return an alarm as programs see it; times in seconds since 1970."""
    return {
        "id": alarm.id,
        "cause": alarm.cause,
        "text": alarm.text,
        "begun_utc": alarm.begun_utc,
        "over_utc": alarm.over_utc,
        "times": alarm.times,
        "seen_by": alarm.seen_by,
    }
