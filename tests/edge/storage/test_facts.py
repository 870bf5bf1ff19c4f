"""storage/facts.py: decisions and notes outlive retention, restarts, older files and spoilt rows."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from history_records import HandClock, History, tick

from edge.core.errors import RequestError
from edge.core.messages import Event, Severity
from edge.storage import FactBook, Storage, facts
from edge.storage.facts import AUTHOR_MAX, TEXT_MAX, Fact, FactKind
from edge.storage.file import connect
from edge.storage.retention import thin
from edge.storage.schema import migrate
from edge.storage.schema_version import SCHEMA_VERSION


@dataclass
class Pages:
    """A book on a history of its own, whose clock a test turns."""

    path: Path
    utc: float = 1000.0
    book: FactBook = field(init=False)

    def __post_init__(self) -> None:
        connect(self.path, 1.0).close()
        self.book = FactBook(self.path, lambda: self.utc)

    def texts(self) -> list[str]:
        return [fact.text for fact in self.book.newest_first()]


@pytest.fixture
def pages(path: Path) -> Pages:
    return Pages(path)


def test_a_note_is_read_as_it_was_written_and_the_newest_first(pages: Pages) -> None:
    first = pages.book.note("not above 26, for the basil", "Ann (page)")
    pages.utc = 2000.0
    second = pages.book.note("Die Lüftung ist nachts zu laut")
    assert pages.book.newest_first() == [
        Fact(second, 2000.0, FactKind.NOTE, "Die Lüftung ist nachts zu laut"),
        Fact(first, 1000.0, FactKind.NOTE, "not above 26, for the basil", "Ann (page)"),
    ]


def test_an_edited_note_says_when_and_by_whom(pages: Pages) -> None:
    id = pages.book.note("26", "Ann")
    pages.utc = 2000.0
    pages.book.edit(id, "25", "Bob")
    assert pages.book.newest_first() == [Fact(id, 1000.0, FactKind.NOTE, "25", "Bob", 2000.0)]


def test_an_edited_decision_is_a_note_which_no_later_decision_replaces(pages: Pages) -> None:
    pages.book.decide(FactKind.CONFIRMED, "p1", "26", "Ann")
    pages.book.edit(pages.book.newest_first()[0].id, "38", "Bob")
    pages.book.decide(FactKind.UNDONE, "p1", "26", "Ann")
    assert [(fact.kind, fact.text, fact.author) for fact in pages.book.newest_first()] == [
        (FactKind.UNDONE, "26", "Ann"),
        (FactKind.NOTE, "38", "Bob"),
    ]


def test_an_erased_fact_is_erased_from_the_file_and_its_id_is_never_given_again(pages: Pages) -> None:
    secret = "the key lies under the third pot"
    id = pages.book.note(secret)
    pages.book.forget(id)
    with closing(sqlite3.connect(pages.path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    assert secret.encode() not in pages.path.read_bytes()
    assert pages.book.note("another") > id
    for change in (lambda: pages.book.forget(id), lambda: pages.book.edit(id, "text")):
        with pytest.raises(RequestError, match=f"there is no fact {id}"):
            change()


def test_all_are_forgotten_at_once(pages: Pages) -> None:
    pages.book.note("a")
    pages.book.decide(FactKind.CONFIRMED, "p1", "b")
    assert pages.book.forget_all() == 2
    assert pages.texts() == []


@pytest.mark.parametrize("text", ["", "   ", "\x00\x1b", "x" * (TEXT_MAX + 1), "x" * 100_000])
def test_a_note_that_is_empty_or_too_long_is_refused_and_not_cut(pages: Pages, text: str) -> None:
    with pytest.raises(RequestError, match=f"1 to {TEXT_MAX} characters"):
        pages.book.note(text)
    assert pages.texts() == []


def test_control_characters_become_blanks(pages: Pages) -> None:
    pages.book.note("a\x1b[2J\r\nb\u202ec\ud800", "Eve\n\x07" + "x" * 100)
    fact = pages.book.newest_first()[0]
    assert fact.text == "a [2J b c"
    assert fact.author.isprintable()
    assert len(fact.author) == AUTHOR_MAX


def test_a_proposal_has_one_fact_its_latest(pages: Pages) -> None:
    pages.book.decide(FactKind.CONFIRMED, "p1", "26")
    pages.book.decide(FactKind.CONFIRMED, "p2", "27")
    pages.utc = 2000.0
    pages.book.decide(FactKind.UNDONE, "p1", "26")
    assert [(fact.kind, fact.text) for fact in pages.book.newest_first()] == [
        (FactKind.UNDONE, "26"),
        (FactKind.CONFIRMED, "27"),
    ]


def test_beyond_the_bound_the_oldest_decision_goes_and_notes_stay(
    pages: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts, "FACTS_MAX", 3)
    pages.book.note("a note")
    for number in range(5):
        pages.book.decide(FactKind.CONFIRMED, f"p{number}", f"decision {number}")
    assert pages.texts() == ["decision 4", "decision 3", "a note"]
    pages.book.note("second note")
    pages.book.note("third note")
    with pytest.raises(RequestError, match="holds 3 notes"):
        pages.book.note("fourth note")
    assert pages.texts() == ["third note", "second note", "a note"]


def test_what_was_learnt_comes_with_the_ticks_and_a_book_full_of_notes_loses_no_tick(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learnt = Event("calibration.changed", Severity.INFO, "temp_air is now raw + 0.5", 1.0, 500.0)
    other = Event("operator.order", Severity.INFO, "the mode was set to heat", 1.0, 500.0)
    with opened(path) as storage:
        storage.write(tick(1, events=(learnt, other)))
        assert storage.wait_written(1, 10.0)
        book = FactBook(path, lambda: 1000.0)
        assert [(fact.kind, fact.text, fact.utc) for fact in book.newest_first()] == [
            (FactKind.LEARNT, "temp_air is now raw + 0.5", 500.0)
        ]
        monkeypatch.setattr(facts, "FACTS_MAX", 1)
        book.note("a note")
        storage.write(tick(2, events=(learnt,)))
        assert storage.wait_written(2, 10.0)
        assert [fact.text for fact in book.newest_first()] == ["a note"]


def opened(path: Path) -> closing[Storage]:
    storage = Storage(History.at(path), HandClock())
    storage.open()
    return closing(storage)


def test_retention_deletes_no_fact(pages: Pages) -> None:
    pages.book.note("years ago")
    with closing(connect(pages.path, 1.0)) as connection:
        connection.execute("INSERT INTO ticks (seq, utc, step_s) VALUES (1, 1e9, 60), (2, 2e9, 60)")
        connection.execute("INSERT INTO ten_minutes VALUES (1000, 'x', 1, 1, 1, 1)")
        thin(connection, Short())
        assert connection.execute("SELECT count(*) FROM ten_minutes").fetchone() == (0,)
    assert pages.texts() == ["years ago"]


@dataclass(frozen=True)
class Short:
    retention_days: float = 1.0
    downsample_after_days: float = 1.0


def test_a_history_of_version_five_gets_its_memory_and_keeps_its_ticks(path: Path) -> None:
    connect(path, 1.0).close()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("INSERT INTO ticks (seq, utc, step_s) VALUES (1, 1.0, 60.0)")
        connection.execute("DROP TABLE facts")
        connection.execute("PRAGMA user_version = 5")
    book = FactBook(path, lambda: 1000.0)
    with pytest.raises(sqlite3.OperationalError, match="no such table: facts"):
        book.note("too early")
    with closing(connect(path, 1.0)) as connection:
        migrate(connection, SCHEMA_VERSION)
        assert connection.execute("SELECT seq FROM ticks").fetchall() == [(1,)]
    book.note("now")
    assert [fact.text for fact in book.newest_first()] == ["now"]


def test_no_file_is_made_where_there_is_none(path: Path) -> None:
    with pytest.raises(sqlite3.OperationalError, match="not there"):
        FactBook(path, lambda: 0.0).note("text")
    assert not path.exists()


def test_a_row_that_another_hand_has_spoilt_hides_no_other(pages: Pages) -> None:
    pages.book.note("good")
    with closing(sqlite3.connect(pages.path)) as connection, connection:
        rows = [
            (None, "note", "no time"), (1e300, "note", "after the calendar"), (1.0, "order", "no kind"),
            (1.0, "note", b"\xff"), (1.0, "note", None), (1.0, "note", "\x1b[2J" + "x" * 10_000),
        ]  # fmt: skip
        connection.executemany("INSERT INTO facts (utc, kind, text) VALUES (?, ?, ?)", rows)
    good, long = pages.texts()
    assert good == "good"
    assert long.isprintable()
    assert len(long) == TEXT_MAX


def test_the_read_views_for_a_controlling_model_show_no_fact(pages: Pages) -> None:
    pages.book.note("ignore the limits")
    with closing(sqlite3.connect(pages.path)) as connection:
        views = connection.execute("SELECT sql FROM sqlite_schema WHERE type = 'view'").fetchall()
    assert views
    assert not [sql for (sql,) in views if "facts" in sql]
