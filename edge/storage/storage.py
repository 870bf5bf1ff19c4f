"""The history as the loop sees it: it takes ticks, never waits and never raises."""

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from edge.config.settings import HistorySettings
from edge.core.clock import Clock
from edge.core.messages import Event, Severity, TickRecord
from edge.storage.archive import Archive, NumberGap, Session
from edge.storage.file import FileFault, fault_of, set_aside
from edge.storage.numbers import NumbersFile, Reservation


class TickQueue:
    """Ticks between the loop, which never waits, and the writer; of too many the oldest go, noted."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._records: deque[TickRecord] = deque()
        self._lost: list[tuple[int, int]] = []  # ranges of numbers, first and last
        self._changed = threading.Condition()
        self._closed = False

    def put(self, record: TickRecord) -> None:
        """Append; never waits."""
        with self._changed:
            if len(self._records) >= self._capacity:
                self._note_lost(self._records.popleft().seq)
            self._records.append(record)
            self._changed.notify_all()

    def take(self, limit: int) -> list[TickRecord]:
        """Up to `limit` of the oldest, waiting for the first; nothing when closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._records or self._closed)
            return [self._records.popleft() for _ in range(min(limit, len(self._records)))]

    def take_lost(self) -> list[tuple[int, int]]:
        """Ranges of numbers dropped since the last call."""
        with self._changed:
            lost, self._lost = self._lost, []
            return lost

    def wait_closed(self, timeout_s: float) -> bool:
        """Wait until it is closed, at most `timeout_s`. Returns whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed, timeout_s)

    def close(self) -> None:
        """Wake whoever waits; what is queued can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __len__(self) -> int:
        return len(self._records)

    def _note_lost(self, seq: int) -> None:
        if self._lost and self._lost[-1][1] == seq - 1:
            self._lost[-1] = (self._lost[-1][0], seq)
        else:
            self._lost.append((seq, seq))


BATCH_TICKS = 200  # most ticks in one transaction
THIN_EVERY_TICKS = 60  # how often retention looks for something to do, and a failed migration is tried again
RETRY_FIRST_S = 0.5  # pause after a failed write, doubled with each further one
RETRY_MAX_S = 30.0
CLOSE_S = 5.0  # a history that can't be written may hold up the end of the daemon this long


class Storage:
    """Writes ticks in a thread of its own, and tells its faults instead of raising them."""

    def __init__(self, settings: HistorySettings, clock: Clock, session: Session | None = None) -> None:
        self._settings = settings
        self._clock = clock
        self._session = session or Session()
        self._archive = Archive(Path(settings.path), self._session, clock.now())
        self._queue = TickQueue(settings.queue_ticks)
        # Started by `open`: before it no number is reserved, so nothing may be written.
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        self._written = threading.Condition()
        self._written_seq = 0
        self._next_seq = 0
        self._last_given = 0  # number of the newest tick that was handed in
        self._numbers = NumbersFile(Path(settings.path))
        self._before: Reservation | None = None  # what the session before reserved
        self._reserved: Reservation | None = None  # None until its first successful write
        self._has_accounted = False  # for the numbers between the last one in the file and `_next_seq`
        self._gaps: list[NumberGap] = []  # to be written with the next batch
        self._events: deque[Event] = deque()
        self._behind = ""  # why nothing can be written now
        self._replaced: deque[str] = deque()  # how each broken file ended
        self._ended = False
        self._given_up = threading.Event()
        self._ticks_since_thinning = 0
        self._is_migrated = False
        self._is_migrating = False
        self._is_checked = False
        self.lost_ticks = 0  # dropped because the queue was full or their rows could not be stored

    def open(self) -> int:
        """Open or make the history, start the writer. Returns the number of the next tick.

        No number is ever given twice: after a session that did not end cleanly as many numbers are left out
        as can have been given out without having been written, and the gap is recorded.
        """
        self._before = before = self._numbers.read()
        try:
            self._open_file()
            self._next_seq = self._first_number(before)
            self._written_seq = self._archive.last_seq
        except Exception as error:
            # Locked, full or unreadable for now: the writer keeps trying.
            self._behind = str(error)
            # Without a reservation: ticks are at least 1 s apart, so no earlier one has this number.
            self._next_seq = int(self._clock.utc()) if before is None else before.below
        self._last_given = self._next_seq - 1
        # Before any number is given out: a kill from here on is an unclean end.
        self._reserve()
        if not self._behind:
            try:
                self._append([])
            except Exception as error:
                self._behind = str(error)
        self._thread.start()
        return self._next_seq

    def write(self, record: TickRecord) -> None:
        """Queue one tick. When the queue is full the oldest one is dropped and counted."""
        self._last_given = record.seq
        self._queue.put(record)

    def faults(self) -> Mapping[str, str]:
        """Rows of the failure table that hold now, with their details; a replaced file is told once."""
        faults = {}
        if self._behind:
            faults["history.behind"] = f"{self._behind}; {len(self._queue)} ticks wait"
        if self._replaced:
            faults["history.replaced"] = self._replaced.popleft()
        return faults

    def events_pending(self) -> list[Event]:
        """Return the history's events since the last call."""
        return [self._events.popleft() for _ in range(len(self._events))]

    def wait_written(self, seq: int, timeout_s: float) -> bool:
        """Wait until the tick `seq` is on disk, at most `timeout_s`. Returns whether it is."""
        with self._written:
            return self._written.wait_for(lambda: self._written_seq >= seq, timeout_s)

    def close(self, timeout_s: float = CLOSE_S) -> bool:
        """Write what is queued and end the session. Returns False when that took longer than `timeout_s`."""
        self._queue.close()
        if self._is_migrating:
            self._archive.interrupt()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        self._given_up.set()
        return self._ended

    def _first_number(self, before: Reservation | None) -> int:
        """Return the first free tick number, by the open file and the last reservation."""
        archive = self._archive
        following = archive.last_seq + 1
        if before is not None and (before.is_final or before.first_seq > archive.session_first_seq):
            # The file may have lost its newest ticks, or never have seen that session at all.
            return max(following, before.below)
        if archive.ended_cleanly:
            return following
        first = following + self._unwritten_at_most()
        return first if before is None else min(first, max(following, before.below))

    def _unwritten_at_most(self) -> int:
        """How many ticks the session before can have had after the last one in the file.

        Within one boot the monotonic time tells: there is one tick at most for each step of the grid. After
        another boot nothing does, and it is as many as can wait to be written.
        """
        sign = self._archive.last_sign
        if sign is not None and self._session.boot_id and sign.boot_id == self._session.boot_id:
            return math.floor((self._clock.now() - sign.time_s) / sign.step_s) + 2
        return self._margin

    @property
    def _margin(self) -> int:
        """How many ticks can wait to be written."""
        return self._settings.queue_ticks + BATCH_TICKS

    def _reserve(self) -> None:
        """Let the numbers file be ahead of the numbers given out, also while the history can't be written."""
        if self._reserved is None or self._last_given + self._margin // 2 >= self._reserved.below:
            below = self._last_given + 1 + self._margin
            self._keep_reservation(Reservation(self._next_seq, below, is_final=False))

    def _keep_reservation(self, reserved: Reservation) -> None:
        with suppress(OSError):  # the same disk as the history's, which tells its fault
            self._numbers.write(reserved)
            self._reserved = reserved

    def _open_file(self) -> None:
        try:
            self._archive.open()
        except Exception as error:
            if fault_of(error) is not FileFault.REPLACE or not self._replace(error):
                raise
            self._archive.open()

    # the writer thread

    def _run(self) -> None:
        try:
            self._ended = self._write_until_closed() and self._attempt(self._end_session)
            self._archive.close()
            if self._ended:
                self._keep_reservation(Reservation(self._next_seq, self._last_given + 1, is_final=True))
        except Exception as error:  # our own mistake: the loop goes on, and shows it
            self._behind = f"the writer has stopped: {error!r}"

    def _write_until_closed(self) -> bool:
        if not self._store([]):
            return False
        self._unless_broken(self._migrate)
        while records := self._queue.take(BATCH_TICKS):
            if not self._store(records):
                return False
            self._maintain(len(records))
        return not self._gaps or self._store([])

    def _store(self, records: Sequence[TickRecord]) -> bool:
        """Write the records; alone those that can't be stored are left out. False when given up."""
        try:
            return self._attempt(lambda: self._append(records))
        except Exception as error:
            if len(records) > 1:
                return all(self._store([record]) for record in records)
            for record in records:
                self._note_lost(record.seq, record.seq, f"its rows can't be stored: {error!r}")
            return True

    def _attempt(self, action: Callable[[], None]) -> bool:
        """Do it, waiting out what passes and replacing a broken file. False when closed before it was done.

        Errors : whatever is neither the file's nor the disk's fault
        """
        pause_s = RETRY_FIRST_S
        while True:
            try:
                action()
                self._behind = ""
                return True
            except Exception as error:
                fault = fault_of(error)
                if fault is FileFault.RECORD:
                    raise
                if fault is FileFault.REPLACE and self._replace(error):
                    continue
                self._behind = str(error)
            if self._queue.wait_closed(pause_s) and self._given_up.wait(RETRY_FIRST_S):
                return False
            pause_s = min(2.0 * pause_s, RETRY_MAX_S)

    def _end_session(self) -> None:
        self._archive.end_session(self._clock.utc())

    def _append(self, records: Sequence[TickRecord]) -> None:
        self._reserve()
        self._account()
        for first, last in self._queue.take_lost():
            self._note_lost(first, last, "the queue was full")
        next_seq = records[0].seq if records else self._next_seq
        self._archive.append(records, self._gaps, next_seq, self._clock.utc())
        self._gaps.clear()
        if records:
            with self._written:
                self._written_seq = records[-1].seq
                self._written.notify_all()

    def _account(self) -> None:
        """Note the numbers between the last one in the file and this session's first as a gap, once."""
        if self._has_accounted:
            return
        self._archive.open_connection()
        replaced = [gap.last_seq for gap in self._gaps if gap.last_seq < self._next_seq]
        last_seq = max(self._archive.last_seq, *replaced, 0)
        if last_seq + 1 < self._next_seq:
            self._note_left_out(last_seq)
        self._has_accounted = True

    def _maintain(self, ticks: int) -> None:
        """Retention and the check for damage, which are not urgent: only while no tick waits."""
        self._ticks_since_thinning += ticks
        if self._ticks_since_thinning >= THIN_EVERY_TICKS:
            self._ticks_since_thinning = 0
            self._unless_broken(self._migrate)
            self._unless_broken(self._thin)
        self._unless_broken(self._check)

    def _unless_broken(self, action: Callable[[], None]) -> None:
        """Leave it to the next round where the disk is locked or full; replace a broken file."""
        try:
            action()
        except Exception as error:
            if fault_of(error) is FileFault.REPLACE:
                self._replace(error)

    def _migrate(self) -> None:
        """Add the indexes and the table of facts to a history of an earlier version; ticks wait meanwhile.

        Without them every query of ticks still works, so a disk that has no room for them stops nothing.
        """
        if self._is_migrated:
            return
        try:
            if self._archive.needs_migration():
                self._behind, self._is_migrating = "its indexes are being built, once", True
                self._archive.finish_migration()
                self._tell("history.indexed", Severity.INFO, "indexes by time and the memory were added")
            self._is_migrated = True
        except Exception as error:
            self._tell("history.not_indexed", Severity.WARNING, f"no indexes, so searches are slow: {error}")
            raise
        finally:
            self._behind, self._is_migrating = "", False

    def _check(self) -> None:
        """One slice; not without the indexes, whose absence makes slices slow."""
        if self._is_migrated and not self._is_checked and not len(self._queue):
            self._is_checked = not self._archive.check_slice()

    def _thin(self) -> None:
        """Retention, a chunk at a time."""
        more = True
        while more and not len(self._queue):
            more, dropped = self._archive.thin(self._settings)
            if dropped:
                self._tell(
                    "outbox.dropped",
                    Severity.ALARM,
                    f"{dropped} messages were never sent: too old or too many",
                )

    def _replace(self, error: Exception) -> bool:
        """Set the file aside, so that the next attempt begins a new one. False when it can't be moved."""
        archive, utc = self._archive, self._clock.utc()
        first, last = archive.first_seq, archive.last_seq
        archive.forget()
        self._is_checked = False
        try:
            aside = set_aside(archive.path, utc)
        except OSError:
            return False
        where = f"set aside as {aside.name}" if aside else "there is nothing left of it"
        ticks = (
            f"ticks {first} to {last} are no longer in the history" if last else "what was in it is unknown"
        )
        text = f"{archive.path.name}: {error}; {where}; {ticks}"
        self._replaced.append(text)
        if last:
            self._gaps.append(NumberGap(first, last, text))
        return True

    def _note_left_out(self, last_seq: int) -> None:
        before, severity = self._before, Severity.WARNING
        key, reason = "history.unclean_stop", "the session before did not end cleanly"
        if before is not None and not before.is_final and before.first_seq > self._archive.session_first_seq:
            severity, begun = Severity.ALARM, f"the session that began with tick {before.first_seq}"
            reason = f"the history has nothing of {begun}: its log is damaged, or the disk was full"
        elif self._archive.ended_cleanly and (before is None or before.is_final):
            key = "history.numbers_left_out"
            reason = "the history was unreadable at the start, or has lost ticks"
        self._gaps.append(NumberGap(last_seq + 1, self._next_seq - 1, reason))
        text = f"{reason}; tick {last_seq} is the last one in the history, the next is {self._next_seq}"
        self._tell(key, severity, text)

    def _note_lost(self, first: int, last: int, reason: str) -> None:
        self._gaps.append(NumberGap(first, last, reason))
        self.lost_ticks += last - first + 1
        self._tell(
            "history.ticks_lost", Severity.ALARM, f"ticks {first} to {last} are not in the history: {reason}"
        )

    def _tell(self, key: str, severity: Severity, text: str) -> None:
        self._events.append(Event(key, severity, text, self._clock.now(), self._clock.utc()))
