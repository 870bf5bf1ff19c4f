"""Alarms as vmalert posts them, by Alertmanager's API: begun, still so, ended; and who has seen them."""

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Engine, or_, select
from sqlalchemy.orm import Session

from edge.core.plain_text import plain, quote
from edge.formats.cross_check import CheckedDocument
from edge.formats.reader import DocumentError, Foreign, read
from fleet.database.tables import NAME_MAX, TEXT_MAX, FleetAlarm, FleetRig

Json = dict[str, Any]

WATCHDOG = "watching"  # an alert that always holds: while it comes, vmalert looks at the rigs
WATCHED_S = 300.0  # without it, after which nobody looks
SHOWN_MAX = 200


@dataclass(frozen=True, slots=True)
class PostedAlert(Foreign, CheckedDocument):
    """An alert as vmalert sends it; one that holds is given an end in the future."""

    labels: Mapping[str, str]
    ends: str = field(metadata={"key": "endsAt"})
    annotations: Mapping[str, str] = field(default_factory=dict)

    def cross_check(self) -> None:
        """Check that its end is a time."""
        try:
            self.ends_utc  # noqa: B018
        except ValueError:
            self.refuse("endsAt", f"{quote(self.ends)} is not a time")

    @property
    def ends_utc(self) -> float:
        """Seconds since 1970."""
        return datetime.fromisoformat(self.ends).timestamp()

    def label(self, name: str, otherwise: str = "") -> str:
        """Return a label as a text that fits into the table."""
        return plain(self.labels.get(name, otherwise), NAME_MAX)

    @property
    def text(self) -> str:
        """Return its sentence."""
        return plain(self.annotations.get("text", ""), TEXT_MAX)


class AlarmShelf:
    """The alarms in the database. Every method is thread-safe."""

    def __init__(self, engine: Engine, utc: Callable[[], float] = time.time) -> None:
        self._engine, self._utc = engine, utc
        self._lock = threading.Lock()  # two posts at once would begin an alarm twice
        self._watched_utc = utc()

    @property
    def silence(self) -> float | None:
        """Seconds since the last sign of vmalert, None while it watches."""
        silent_s = self._utc() - self._watched_utc
        return None if silent_s < WATCHED_S else silent_s

    def take(self, alerts: Iterable[PostedAlert]) -> None:
        """Store alerts: one that is new begins, one that is known goes on or ends."""
        now = self._utc()
        with self._lock, Session(self._engine) as session, session.begin():
            lasting = select(FleetAlarm).where(FleetAlarm.ended_utc.is_(None))
            known = {(alarm.name, alarm.rig): alarm for alarm in session.scalars(lasting)}
            for alert in alerts:
                if alert.label("alertname") == WATCHDOG:
                    self._watched_utc = now
                else:
                    _note(session, known, alert, now)

    def newest(self, groups: frozenset[str] | None, lasting: bool, before_utc: float | None) -> list[Json]:
        """Return alarms of these groups, None for all; those that last alone, or all, the newest first."""
        query = select(FleetAlarm, FleetRig.group).join(
            FleetRig, FleetRig.name == FleetAlarm.rig, isouter=True
        )
        query = query.where(_of(groups)).order_by(FleetAlarm.first_utc.desc(), FleetAlarm.id.desc())
        if lasting:
            query = query.where(FleetAlarm.ended_utc.is_(None))
        if before_utc is not None:
            query = query.where(FleetAlarm.first_utc < before_utc)
        with Session(self._engine) as session:
            return [_json(alarm, group) for alarm, group in session.execute(query.limit(SHOWN_MAX))]

    def group_of(self, number: int) -> str | None:
        """Return the group of an alarm's rig, "" for one of the whole fleet, None where there is no alarm."""
        with Session(self._engine) as session:
            alarm = session.get(FleetAlarm, number)
            if alarm is None:
                return None
            rig = session.get(FleetRig, alarm.rig)
            return "" if rig is None else rig.group

    def acknowledge(self, number: int, name: str) -> None:
        """Note who has seen an alarm; the first one stays."""
        with Session(self._engine) as session, session.begin():
            alarm = session.get(FleetAlarm, number)
            if alarm is not None and alarm.seen_by is None:
                alarm.seen_by = name


def read_alerts(document: object) -> list[PostedAlert]:
    """Return the alerts of a request. Errors: DocumentError"""
    if not isinstance(document, list):
        raise DocumentError("alerts", [("", "must be a list")])
    return [read(PostedAlert, each, "alerts", key=f"[{place}]") for place, each in enumerate(document)]


def _note(session: Session, known: dict[tuple[str, str], FleetAlarm], alert: PostedAlert, now: float) -> None:
    key = (alert.label("alertname"), alert.label("rig"))
    alarm = known.get(key)
    if alarm is None and alert.ends_utc > now:
        alarm = FleetAlarm(
            name=key[0], rig=key[1], severity=alert.label("severity", "warning"), first_utc=now
        )
        session.add(alarm)
        known[key] = alarm
    if alarm is not None:
        alarm.text, alarm.last_utc = alert.text, now
        if alert.ends_utc <= now:
            alarm.ended_utc = now
            del known[key]


def _of(groups: frozenset[str] | None) -> ColumnElement[bool]:
    if groups is None:
        return FleetAlarm.id.is_not(None)
    return or_(FleetAlarm.rig == "", FleetRig.group.in_(groups))


def _json(alarm: FleetAlarm, group: str | None) -> Json:
    keys = ("id", "name", "rig", "severity", "text", "first_utc", "last_utc", "ended_utc", "seen_by")
    return {key: getattr(alarm, key) for key in keys} | {"group": group or ""}
