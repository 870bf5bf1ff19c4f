"""Tick numbers over restarts: none is given twice, and each that is not in the history is in a gap."""

import os
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from history_records import START_UTC, HandClock, History, tick

from edge.core.messages import Severity
from edge.storage import Session, Storage
from edge.storage import storage as storage_module
from edge.storage.numbers import NumbersFile, Reservation

PATIENCE_S = 20.0
QUEUE_TICKS = 20
FILES = ("", "-wal", "-numbers")
SMALL_DISK = "size=2m"

needs_mount = pytest.mark.skipif(os.getuid() != 0, reason="only root mounts a small disk")


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RETRY_FIRST_S", "RETRY_MAX_S"):
        monkeypatch.setattr(storage_module, name, 0.02)
    monkeypatch.setattr("edge.storage.archive.BUSY_S", 0.02)
    monkeypatch.setattr(storage_module, "BATCH_TICKS", 10)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", SMALL_DISK, "tmpfs", str(folder)]).returncode:
        pytest.skip("this machine mounts nothing")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


class NumberingDaemon:
    """A daemon's use of its history: numbers from `open` on, ticks, an end or a kill."""

    def __init__(self, path: Path, boot_id: str = "", now_s: float = 0.0) -> None:
        self.path = path
        self.storage = Storage(
            History.at(path, queue_ticks=QUEUE_TICKS), HandClock(now_s), Session(boot_id=boot_id)
        )
        self.first = self.next = self.storage.open()

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.storage.write(tick(self.next))
            self.next += 1

    def is_written(self) -> bool:
        return self.storage.wait_written(self.next - 1, PATIENCE_S)

    def end(self) -> None:
        assert self.storage.close(PATIENCE_S)

    def kill(self) -> None:
        """Leave the files as they are at this moment."""
        shots = {suffix: Path(f"{self.path}{suffix}") for suffix in FILES}
        left = {suffix: file.read_bytes() for suffix, file in shots.items() if file.exists()}
        self.storage._given_up.set()
        self.storage.close(PATIENCE_S)
        for suffix, file in shots.items():
            file.unlink(missing_ok=True)
            if suffix in left:
                file.write_bytes(left[suffix])
        Path(f"{self.path}-shm").unlink(missing_ok=True)

    def events(self) -> list[str]:
        return [event.key for event in self.storage.events_pending()]


def lived(path: Path, ticks: int = 1, boot_id: str = "") -> None:
    """Leave a history of these ticks and a clean end."""
    daemon = NumberingDaemon(path, boot_id)
    daemon.tick(ticks)
    daemon.end()


def numbers(path: Path) -> tuple[set[int], set[int]]:
    """Stored, and in gaps."""
    with closing(sqlite3.connect(path)) as connection:
        stored = [seq for (seq,) in connection.execute("SELECT seq FROM ticks")]
        gaps = connection.execute("SELECT first_seq, last_seq FROM gaps").fetchall()
    missing = [seq for first, last in gaps for seq in range(first, last + 1)]
    assert len(set(stored)) == len(stored)
    assert len(set(missing)) == len(missing), "reported twice"
    return set(stored), set(missing)


def accounted(path: Path) -> None:
    """Every number up to the newest is stored once or reported missing."""
    stored, missing = numbers(path)
    assert stored.isdisjoint(missing)
    assert stored | missing == set(range(1, max(stored) + 1))


def fill(disk: Path) -> Path:
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file, pytest.raises(OSError, match="No space"):
        while True:
            file.write(bytes(4096))
    return ballast


# a full disk


@needs_mount
def test_a_restart_on_a_full_disk_continues_the_numbers(small_disk: Path) -> None:
    path = small_disk / "history.db"
    lived(path, 15)
    ballast = fill(small_disk)
    daemon = NumberingDaemon(path)
    assert daemon.first == 16
    daemon.tick(5)
    ballast.unlink()
    assert daemon.is_written()
    daemon.end()
    assert numbers(path) == (set(range(1, 21)), set())


@pytest.mark.slow
@needs_mount
@pytest.mark.parametrize("ticks", [3, 100])  # the latter more than wait for a disk
def test_ticks_of_a_session_that_could_write_nothing_are_reported(small_disk: Path, ticks: int) -> None:
    path = small_disk / "history.db"
    lived(path, 15)
    ballast = fill(small_disk)
    daemon = NumberingDaemon(path)
    for _ in range(ticks):
        daemon.tick()
        if daemon.next % 5 == 0:
            storage_module.threading.Event().wait(0.05)  # the writer tries again and again meanwhile
    last_given = daemon.next - 1
    daemon.storage._given_up.set()
    daemon.storage.close(PATIENCE_S)
    ballast.unlink()
    daemon = NumberingDaemon(path)
    assert daemon.first > last_given
    assert "history.unclean_stop" in daemon.events()
    daemon.tick()
    daemon.end()
    accounted(path)


def test_numbers_of_the_clock_are_followed_by_a_gap(path: Path) -> None:
    """A history of software without the numbers file, unreadable at the start."""
    lived(path, 3)
    Path(f"{path}-numbers").unlink()
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        daemon = NumberingDaemon(path)
        assert daemon.first == START_UTC
        daemon.tick()
    assert daemon.is_written()
    assert daemon.events() == ["history.numbers_left_out"]
    daemon.end()
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT first_seq, last_seq FROM gaps").fetchall() == [(4, START_UTC - 1)]


def test_a_history_that_is_locked_at_the_start_continues_its_numbers(path: Path) -> None:
    lived(path, 3)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        daemon = NumberingDaemon(path)
        assert daemon.first == 4
        assert "locked" in daemon.storage.faults()["history.behind"]
        daemon.tick()
    assert daemon.is_written()
    assert daemon.events() == []
    daemon.end()
    accounted(path)


# a damaged log


@pytest.mark.parametrize("place", [0, 5000, 30_000])
@pytest.mark.parametrize("sessions_before", [0, 1])
def test_a_damaged_log_gives_no_number_twice(path: Path, sessions_before: int, place: int) -> None:
    for _ in range(sessions_before):
        lived(path, 15, "boot")
    daemon = NumberingDaemon(path, "boot")
    daemon.tick(8)
    assert daemon.is_written()
    last_given = daemon.next - 1
    daemon.kill()
    with Path(f"{path}-wal").open("r+b") as log:
        log.seek(place)
        log.write(os.urandom(64))
    daemon = NumberingDaemon(path, "boot", now_s=60.0 * last_given)
    assert daemon.first > last_given
    (event,) = (event for event in daemon.storage.events_pending() if event.key == "history.unclean_stop")
    first = last_given - 7
    if place == 0 or (place, sessions_before) == (5000, 0):  # eight ticks had been written, all in the log
        assert event.severity is Severity.ALARM
        assert f"nothing of the session that began with tick {first}: its log is damaged" in event.text
        assert f"tick {first - 1} is the last one in the history, the next is {daemon.first}" in event.text
    else:
        assert event.severity is Severity.WARNING
    daemon.tick()
    daemon.end()
    accounted(path)


# an end


def test_a_last_tick_that_cannot_be_stored_is_reported(path: Path) -> None:
    daemon = NumberingDaemon(path)
    daemon.tick()
    daemon.storage.write(tick(2, mode=object()))
    daemon.next = 3
    daemon.end()
    assert numbers(path) == ({1}, {2})
    daemon = NumberingDaemon(path)
    assert daemon.first == 3
    assert daemon.events() == []
    daemon.end()


def test_a_clean_end_leaves_no_gap(path: Path) -> None:
    for ended in (0, 2, 4):
        daemon = NumberingDaemon(path)
        assert (daemon.first, daemon.events()) == (ended + 1, [])
        daemon.tick(2)
        daemon.end()
    assert numbers(path) == (set(range(1, 7)), set())


def test_a_deleted_history_is_followed_by_one_with_later_numbers(path: Path) -> None:
    lived(path, 5)
    path.unlink()
    daemon = NumberingDaemon(path)
    assert daemon.first == 6
    assert daemon.events() == ["history.numbers_left_out"]
    daemon.tick()
    daemon.end()
    accounted(path)


# the file itself


def test_a_reservation_reads_back(path: Path) -> None:
    file = NumbersFile(path)
    for reserved in (Reservation(10**12, 10**12 + 9, False), Reservation(1, 2, True)):
        file.write(reserved)
        assert file.read() == reserved


@pytest.mark.parametrize("content", [b"", b"\0" * 128, b"[]", b'{"below": 3}', b"\xff\xfe", b"[" * 128])
def test_a_broken_reservation_counts_as_none(path: Path, content: bytes) -> None:
    Path(f"{path}-numbers").write_bytes(content)
    assert NumbersFile(path).read() is None


@needs_mount
def test_a_reservation_is_renewed_on_a_full_disk(small_disk: Path) -> None:
    file = NumbersFile(small_disk / "history.db")
    file.write(Reservation(1, 250, False))
    fill(small_disk)
    file.write(Reservation(1, 10**9, False))
    assert file.read() == Reservation(1, 10**9, False)
