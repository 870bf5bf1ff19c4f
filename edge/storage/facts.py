"""Dated facts: what operators decided and noted, and what was learnt about this rig.

They stand in the history, so a backup holds them, and retention never deletes them. No read view shows them:
a controlling language model that may query the history cannot see them.
"""

import json
import math
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from edge.core.errors import RequestError
from edge.core.messages import TickRecord
from edge.core.plain_text import plain
from edge.storage.file import connect

TEXT_MAX = 500  # characters of a fact: an operator's words and the settings made of them
AUTHOR_MAX = 60  # characters, as in orders
FACTS_MAX = 1000  # some years at a few decisions a week; all of them are read for each question
BUSY_S = 1.0
# Events of the history that say what was learnt about the rig.
LEARNT_EVENTS = ("calibration.changed", "diagnosis.adopted")
_UTC_MAX = 253_402_300_799.0  # the last second of the year 9999, the calendar's end [s since 1970]
# A row that another hand has spoilt is not read: it must not keep the others from being read.
_READ = f"""
SELECT id, utc, kind, text, coalesce(author, ''), edited_utc FROM facts
WHERE utc BETWEEN 0 AND {_UTC_MAX} AND kind IN (SELECT value FROM json_each(?)) AND typeof(text) = 'text'
ORDER BY utc DESC, id DESC
"""
_INSERT = "INSERT INTO facts (utc, kind, text, author, about) VALUES (?, ?, ?, ?, ?)"


class FactKind(Enum):
    """The origin of a fact."""

    NOTE = "note"  # written by a person
    CONFIRMED = "confirmed"  # a proposal that a person applied
    DISCARDED = "discarded"  # a proposal that a person did not want
    UNDONE = "undone"  # a proposal that a person applied and took back
    LEARNT = "learnt"  # about the rig: a calibration, an adopted twin


@dataclass(frozen=True, slots=True)
class Fact:
    """One row. utc : of the decision, the note or the event; author : "" where nobody is known"""

    id: int  # never given twice
    utc: float
    kind: FactKind
    text: str
    author: str = ""
    edited_utc: float | None = None


def insert_learnt(connection: sqlite3.Connection, records: Sequence[TickRecord]) -> None:
    """Insert what the ticks' events say about the rig, in the transaction that the caller holds."""
    rows = [
        (event.utc, FactKind.LEARNT.value, plain(event.text, TEXT_MAX), "", "")
        for record in records
        for event in record.events
        if event.key in LEARNT_EVENTS and math.isfinite(event.utc)
    ]
    if rows:
        connection.executemany(_INSERT, rows)
        _make_room(connection)


class FactBook:
    """The facts in the history at `path`; for any thread, each call on a connection of its own.

    Errors : sqlite3.Error from every method, while the file is locked, broken or not there
    """

    def __init__(self, path: str | Path, utc: Callable[[], float]) -> None:
        self._path, self._utc = Path(path), utc

    def newest_first(self) -> list[Fact]:
        """Return all facts."""
        kinds = json.dumps([kind.value for kind in FactKind])
        with self._transaction("BEGIN") as connection:  # a writer's lock keeps nobody from reading
            rows = connection.execute(_READ, (kinds,)).fetchall()
        return [
            Fact(id, utc, FactKind(kind), plain(text, TEXT_MAX), plain(str(author), AUTHOR_MAX), edited_utc)
            for id, utc, kind, text, author, edited_utc in rows
        ]

    def note(self, text: str, author: str = "") -> int:
        """Write a person's note; return its id. Errors: RequestError where the book is full of notes"""
        with self._transaction() as connection:
            return self._insert(connection, FactKind.NOTE, _one_line(text), author, "")

    def decide(self, kind: FactKind, about: str, text: str, author: str = "") -> None:
        """Write a decision about a proposal, in the place of an earlier one about the same.

        A proposal that was undone must not stand there as confirmed too: a reader who sees one row of the
        two would believe it.
        """
        with self._transaction() as connection:
            connection.execute("DELETE FROM facts WHERE about = ?", (about,))
            self._insert(connection, kind, plain(text, TEXT_MAX), author, about)

    def edit(self, id: int, text: str, author: str = "") -> None:
        """Replace a text, and its author by who edited it. Errors: RequestError without this fact

        The fact is a note from then on: else it would say that somebody had confirmed the new words.
        """
        with self._transaction() as connection:
            changed = connection.execute(
                "UPDATE facts SET kind = ?, about = '', text = ?, author = ?, edited_utc = ? WHERE id = ?",
                (FactKind.NOTE.value, _one_line(text), plain(author, AUTHOR_MAX), self._utc(), id),
            ).rowcount
            _refuse_missing(id, changed)

    def forget(self, id: int) -> None:
        """Erase one fact. Errors: RequestError without it"""
        with self._transaction() as connection:
            _refuse_missing(id, connection.execute("DELETE FROM facts WHERE id = ?", (id,)).rowcount)

    def forget_all(self) -> int:
        """Erase every fact; return how many there were."""
        with self._transaction() as connection:
            return connection.execute("DELETE FROM facts").rowcount

    def _insert(
        self, connection: sqlite3.Connection, kind: FactKind, text: str, author: str, about: str
    ) -> int:
        row = (self._utc(), kind.value, text, plain(author, AUTHOR_MAX), about)
        id = connection.execute(_INSERT, row).lastrowid
        _make_room(connection)
        assert id is not None
        return id

    @contextmanager
    def _transaction(self, begin: str = "BEGIN IMMEDIATE") -> Iterator[sqlite3.Connection]:
        """Yield a connection in a transaction. Errors: sqlite3.Error"""
        if not self._path.exists():
            raise sqlite3.OperationalError(f"{self._path} is not there")  # the writer makes it
        with closing(connect(self._path, BUSY_S)) as connection:
            connection.execute("PRAGMA secure_delete = ON")  # an erased text is overwritten by zeros
            connection.execute(begin)
            try:
                yield connection
                connection.execute("COMMIT")
            finally:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")


def _one_line(text: str) -> str:
    """Return a person's text in one line. Errors: RequestError for an empty or a long one"""
    # Refused, not cut: what a person wrote must not lose its end unseen.
    if len(text) > TEXT_MAX or not (line := plain(text, TEXT_MAX)):
        raise RequestError(f"text: 1 to {TEXT_MAX} characters are needed")
    return line


def _refuse_missing(id: int, changed: int) -> None:
    if not changed:
        raise RequestError(f"id: there is no fact {id}; `greenhouse memory` lists them")


def _make_room(connection: sqlite3.Connection) -> None:
    """Delete the oldest decisions beyond FACTS_MAX; a person's notes stay. Errors: RequestError"""
    excess = connection.execute("SELECT count(*) FROM facts").fetchone()[0] - FACTS_MAX
    if excess <= 0:
        return
    deleted = connection.execute(
        "DELETE FROM facts WHERE id IN (SELECT id FROM facts WHERE kind != ? ORDER BY utc, id LIMIT ?)",
        (FactKind.NOTE.value, excess),
    ).rowcount
    if deleted < excess:
        raise RequestError(f"the memory holds {FACTS_MAX} notes: forget some of them first")
