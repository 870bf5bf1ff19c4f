"""The check for damage reads every table and index of the file, a little at a time, and changes nothing."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from history_records import HandClock, History, eventful_tick, store, tick

from edge.storage import Storage, file
from edge.storage.file import PAGE_BYTES, FileFault, SliceCheck, fault_of

TICKS = 300


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "history.db"
    store(path, *(eventful_tick(seq) if seq % 2 else tick(seq) for seq in range(1, TICKS + 1)))
    return path


def check(path: Path) -> int:
    """All slices; returns how many."""
    slices, pass_ = 1, SliceCheck(path, 1.0)
    while pass_.step():
        slices += 1
    return slices


def pages(path: Path) -> dict[str, list[int]]:
    """Leaf pages of each table and index of the file; by its root's tree where sqlite has no dbstat."""
    with closing(sqlite3.connect(path)) as connection:
        found: dict[str, list[int]] = {}
        try:
            rows = connection.execute("SELECT name, pageno FROM dbstat WHERE pagetype = 'leaf'").fetchall()
        except sqlite3.OperationalError:
            rows = connection.execute(
                "SELECT name, rootpage FROM sqlite_master WHERE rootpage > 0"
            ).fetchall()
        for name, number in rows:
            found.setdefault(name, []).append(number)
    return found


def test_a_whole_file_passes_and_is_not_changed(path: Path) -> None:
    before = path.read_bytes()
    check(path)
    assert path.read_bytes() == before


def test_a_slice_is_small_and_all_slices_together_are_the_file(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file, "SLICE_ROWS", 50)
    # 150 plain ticks have three readings, 150 eventful ones one; one more slice finds nothing left.
    assert check(path) == (150 * 3 + 150) // 50 + 1


@pytest.mark.parametrize(
    "tree",
    [
        *("ticks", "readings", "decisions", "forecasts", "changes", "events", "outbox"),
        *("ticks_by_utc", "events_by_utc", "outbox_by_seq"),
    ],
)
def test_a_damaged_page_is_found_wherever_it_is(path: Path, tree: str) -> None:
    data = bytearray(path.read_bytes())
    page = pages(path)[tree][0]  # the oldest rows: what no other query reads
    data[(page - 1) * PAGE_BYTES : (page - 1) * PAGE_BYTES + 64] = b"\xa5" * 64
    path.write_bytes(data)
    with pytest.raises(sqlite3.DatabaseError) as caught:
        check(path)
    assert fault_of(caught.value) is FileFault.REPLACE


def test_a_missing_file_is_not_made(path: Path) -> None:
    path.unlink()
    with pytest.raises(sqlite3.OperationalError):
        SliceCheck(path, 1.0).step()
    assert not path.exists()


def test_the_writer_replaces_a_file_whose_old_rows_are_damaged(path: Path) -> None:
    data = bytearray(path.read_bytes())
    page = pages(path)["decisions"][0]
    data[(page - 1) * PAGE_BYTES : (page - 1) * PAGE_BYTES + 64] = b"\xa5" * 64
    path.write_bytes(data)
    storage = Storage(History.at(path), HandClock())
    first = storage.open()
    faults: dict[str, str] = {}
    for seq in range(first, first + 40):
        storage.write(tick(seq))
        assert storage.wait_written(seq, 20.0)
        faults |= storage.faults()
    assert storage.close(20.0)
    assert "ticks 1 to 3" in faults["history.replaced"]  # the 300 and what came before the slice was read
