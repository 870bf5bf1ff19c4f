"""The memory of the alarms over a restart: one document in the page's database."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from edge.core.errors import DataError
from edge.formats.reader import parse_json, read
from edge.page.access import Access
from edge.page.alarms.alarm_book import EventPlace, RigAlarm

FACT = "alarms"
BYTES_MAX = 1 << 20


@dataclass(frozen=True, slots=True)
class ChannelNote:
    """How a channel has done: when a message arrived, and when and why one did not."""

    sent_utc: float | None = None
    failed_utc: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class AlarmState:
    """All that is remembered. place : of the history, up to which its events have been read"""

    place: EventPlace | None = None
    alarms: tuple[RigAlarm, ...] = ()
    notes: Mapping[str, ChannelNote] = field(default_factory=dict)


def load(access: Access) -> AlarmState:
    """Return the state of the page's last run, an empty one for the first. Errors: DataError"""
    text = access.fact(FACT)
    if text is None:
        return AlarmState()
    return read(AlarmState, parse_json(text, f"{access.path}: {FACT}", BYTES_MAX), f"{access.path}: {FACT}")


def save(access: Access, state: AlarmState) -> None:
    """Save the state, on the disk when the call returns. Errors: DataError"""
    try:
        text = json.dumps(asdict(state), allow_nan=False)
    except ValueError as error:
        raise DataError(f"{access.path}: {FACT}: {error}") from error
    access.set_fact(FACT, text)
