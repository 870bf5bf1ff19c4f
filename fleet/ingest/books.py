"""Rigs, spans, events and refusals in the database: read for a batch, and written in one transaction."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from sqlalchemy import Engine, TableClause, bindparam, delete, insert, select, update
from sqlalchemy.orm import Session

from fleet.database.tables import AbsentSpan, FleetRig, Refusal, RigEvent, StoredSpan, ToldTwin
from fleet.ingest.ledger import HistoryLedger, changed_spans
from fleet.ingest.state import HeardTwin
from fleet.ingest.tick import Tick

Histories = Mapping[str, HistoryLedger]
Row = dict[str, Any]
Table = type[StoredSpan] | type[AbsentSpan]


@dataclass(slots=True)
class Entry:
    """The changes of one batch.

    rigs : values of columns of `rigs`, by name, of each rig of which something came
    spans : before and after, by rig, of the histories that changed
    gone : rigs that are online no more, where they have a row
    refused : counts and the newest text, by rig and reason
    """

    utc: float
    rigs: dict[str, dict[str, Any]] = field(default_factory=dict)
    spans: Mapping[str, tuple[Histories, Histories]] = field(default_factory=dict)
    ticks: list[Tick] = field(default_factory=list)
    twins: Mapping[str, HeardTwin | None] = field(default_factory=dict)
    gone: Iterable[str] = ()
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)
    texts: dict[tuple[str, str], str] = field(default_factory=dict)


class Books:
    """One process writes them. check : raises in a transaction that is another process's to write

    Errors : SQLAlchemyError from every method, and what `check` raises; nothing of an entry is kept then
    """

    def __init__(self, engine: Engine, check: Callable[[Session], None] = lambda _: None) -> None:
        self._engine, self._check = engine, check

    def names(self) -> set[str]:
        """Return the names of all rigs."""
        with Session(self._engine) as session:
            return set(session.scalars(select(FleetRig.name)))

    def histories(self, rigs: Iterable[str]) -> dict[str, dict[str, HistoryLedger]]:
        """Return what is stored and what is absent, of these rigs."""
        found: dict[str, dict[str, HistoryLedger]] = {rig: {} for rig in rigs}
        with Session(self._engine) as session:
            for table, kind in ((StoredSpan, "stored"), (AbsentSpan, "absent")):
                for names in _portions(list(found)):
                    columns = (table.rig, table.history_id, table.first_seq, table.last_seq)
                    for rig, history_id, first, last in session.execute(
                        select(*columns).where(table.rig.in_(names))
                    ):
                        own = found[rig].setdefault(history_id, HistoryLedger())
                        getattr(own, kind).add(first, last)
        return found

    def write(self, entry: Entry) -> None:
        """Write all of an entry, or nothing."""
        with Session(self._engine) as session, session.begin():
            self._check(session)
            _write_rigs(session, entry)
            for table, kind in ((StoredSpan, "stored"), (AbsentSpan, "absent")):
                _write_spans(session, table, *_changes(entry, kind))
            _write_events(session, entry.ticks)
            _write_twins(session, entry)
            _write_refusals(session, entry)


PORTION = 500  # names in one query


def _portions(names: list[str]) -> Iterable[list[str]]:
    return (names[place : place + PORTION] for place in range(0, len(names), PORTION))


def _write_rigs(session: Session, entry: Entry) -> None:
    known: set[str] = set()
    for names in _portions(list(entry.rigs)):
        known |= set(session.scalars(select(FleetRig.name).where(FleetRig.name.in_(names))))
    fresh = [name for name in entry.rigs if name not in known]
    if fresh:
        usual = {"group": "", "kind": "", "is_online": False, "state": {}, "first_utc": entry.utc}
        rows = [{"name": name, "last_utc": 0.0, **usual} for name in fresh]
        session.execute(insert(FleetRig), rows)
    changed: dict[tuple[str, ...], list[dict[str, Any]]] = {}  # rows of the same columns go together
    for name, values in entry.rigs.items():
        if values:
            row = {"name": name, **values}
            changed.setdefault(tuple(row), []).append(row)
    for rows in changed.values():
        session.execute(update(FleetRig), rows)
    for names in _portions(list(entry.gone)):
        session.execute(update(FleetRig).where(FleetRig.name.in_(names)).values(is_online=False))


def _changes(entry: Entry, kind: str) -> tuple[list[Row], list[Row]]:
    """Return the rows that go and those that are new, of one table. kind : of the ledger's spans"""
    gone: list[Row] = []
    new: list[Row] = []
    for rig, (before, after) in entry.spans.items():
        for history_id, own in after.items():
            place = {"rig": rig, "history_id": history_id}
            old = getattr(before.get(history_id, HistoryLedger()), kind)
            firsts, spans = changed_spans(old, getattr(own, kind))
            gone += [{"of_rig": rig, "of_history": history_id, "first": first} for first in firsts]
            new += [{**place, "first_seq": first, "last_seq": last} for first, last in spans]
    return gone, new


def _write_spans(session: Session, table: Table, gone: list[Row], new: list[Row]) -> None:
    if gone:
        chosen = (
            table.rig == bindparam("of_rig"),
            table.history_id == bindparam("of_history"),
            table.first_seq == bindparam("first"),
        )
        # The table's own statement: the session's would look each row up.
        session.connection().execute(delete(cast(TableClause, table.__table__)).where(*chosen), gone)
    if new:
        session.connection().execute(insert(cast(TableClause, table.__table__)), new)


def _write_events(session: Session, ticks: Iterable[Tick]) -> None:
    for tick in ticks:
        for number, event in enumerate(tick.events):
            session.merge(
                RigEvent(
                    rig=tick.rig,
                    history_id=tick.history_id,
                    seq=tick.seq,
                    number=number,
                    utc=tick.utc if event.utc is None else event.utc,
                    key=event.key,
                    severity=event.severity,
                    text=event.text,
                )
            )


def _write_twins(session: Session, entry: Entry) -> None:
    for rig, twin in entry.twins.items():
        if twin is not None:
            told = ToldTwin(rig=rig, bundle=twin.bundle, utc=entry.utc, document=twin.document)
            session.merge(told)
        elif (known := session.get(ToldTwin, rig)) is not None:
            session.delete(known)


def _write_refusals(session: Session, entry: Entry) -> None:
    for (rig, reason), count in entry.refused.items():
        row = session.get(Refusal, (rig, reason))
        if row is None:
            row = Refusal(rig=rig, reason=reason, count=0, first_utc=entry.utc, last_utc=entry.utc, text="")
            session.add(row)
        row.count += count
        row.last_utc, row.text = entry.utc, entry.texts[rig, reason]
