"""The loop of ingest: hear, write the numbers, write the database, acknowledge; and ask for what is missing.

In this order, so a kill at any moment leaves at most messages that the broker sends again, whose samples are
in store already and are the same.
"""

import json
import re
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from edge.app.systemd import Notifier
from edge.config.settings import NAME
from edge.core.errors import ConfigError, DataError
from edge.core.event_log import Allowance
from edge.core.plain_text import plain
from fleet.database.lease import FleetLease
from fleet.ingest.batch import Batch, Times
from fleet.ingest.books import Books
from fleet.ingest.inbox import FleetInbox, Message
from fleet.ingest.ledger import RigLedger
from fleet.ingest.spans import Refused
from fleet.ingest.writer import BatchReport, BatchWriter, RigRefusals
from fleet.numbers.victoria import Numbers, NumbersError
from fleet.settings import FleetSettings

DEDUP = "dedup.minScrapeInterval"
DEDUP_VALUE = "1ms"  # removes samples of one series and time, and never a tick
RETENTION = "retentionPeriod"
DAYS = {"h": 1 / 24, "d": 1.0, "w": 7.0, "": 31.0, "y": 365.0}  # without a unit it means months of 31 days
_PERIOD = re.compile(r"([0-9.]+)([hdwy]?)")
WORK = "what rigs send"  # of the lease
DAY_S = 86400.0
RETRY_FIRST_S, RETRY_MAX_S = 0.5, 4.0
WATCHED_S = 60.0  # a batch is three requests with a time limit of 30 s each, and a transaction
LOOK_S = 1.0  # between two looks at the gaps of all rigs, and no more than this share of the time:
LOOK_SHARE = 0.05
ASKS_MAX = 50  # rigs that send again at one time
CHECK_S = 60.0  # how often VictoriaMetrics is asked whether it has dropped samples
SAID_BURST, SAID_PER_S = 10, 0.1  # lines about refusals; the database counts all of them


def problem(options: Mapping[str, str], retention_days: float) -> str:
    """Return why an option is wrong, "" for none. retention_days : that the settings promise"""
    dedup = options.get(DEDUP, "")
    if dedup != DEDUP_VALUE:
        return f"-{DEDUP}={dedup}: must be {DEDUP_VALUE}, or a tick that comes twice is in store twice"
    kept_days = days(options.get(RETENTION, ""))
    if kept_days < retention_days:
        return f"-{RETENTION}: keeps {kept_days:g} days, but numbers.retention_days is {retention_days:g}"
    return ""


def days(period: str) -> float:
    """Return a period as VictoriaMetrics writes it, 0 for one that is none [days]."""
    found = _PERIOD.fullmatch(period)
    return float(found[1]) * DAYS[found[2]] if found else 0.0


class Ingest:
    """The service: all that rigs send, once in store. journal : a file of measurements, or None

    Errors : ConfigError; DataError for a database that cannot be read
    """

    def __init__(self, settings: FleetSettings, engine: Engine, journal: Path | None = None) -> None:
        self._settings, self._journal = settings, journal
        self._numbers = Numbers(settings.numbers)
        self._inbox = FleetInbox(settings.mqtt, settings.ingest.window)
        self._lease = FleetLease(engine, WORK)
        books = Books(engine, self._lease.check)
        self._ledgers = {name: RigLedger(settings.ingest.gap_wait_s) for name in _names(books)}
        self._writer = BatchWriter(self._numbers, books, self._ledgers)
        self._allowance = Allowance(SAID_BURST, SAID_PER_S, time.monotonic)
        self._look_at_s = 0.0
        self._check_at_s = 0.0
        self._dropped = 0.0
        self._is_behind = False
        self._notifier = Notifier.from_environment()

    def run(self, ended: threading.Event) -> None:
        """Run until `ended`. Whatever does not answer is tried again.

        Errors : ConfigError; LeaseLost where another process took this one, which stood still, for dead
        """
        self._notifier.ready("waits for VictoriaMetrics", WATCHED_S)
        try:
            # The broker knows one ingest: a second connection would end the first one's, so it waits.
            if self._wait_for_stores(ended):
                with self._lease.keep():
                    self._serve(ended)
        finally:
            self._notifier.close()

    def _serve(self, ended: threading.Event) -> None:
        own = self._settings.ingest
        self._inbox.start()
        try:
            while not ended.is_set():
                messages = self._inbox.take(own.batch_s)
                self._is_behind = len(messages) >= own.window // 2
                if messages and self._store(messages, ended):
                    self._inbox.acknowledge(messages)
                self._ask()
                self._check()
                self._notifier.alive(f"{len(self._ledgers)} rigs")
        finally:
            self._inbox.close()

    def _wait_for_stores(self, ended: threading.Event) -> bool:
        """Return once both answer and no other process does the work: before, nothing could be stored."""
        while not ended.is_set():
            try:
                self._check_options()
                return self._lease.wait(ended, _say, self._notifier.alive)
            except (NumbersError, SQLAlchemyError) as error:
                _say(f"{plain(str(error))}; again in {RETRY_MAX_S:g} s")
                self._notifier.alive(plain(str(error)))
                ended.wait(RETRY_MAX_S)
        return False

    def _check_options(self) -> None:
        wrong = problem(self._numbers.options(), self._settings.numbers.retention_days)
        if wrong:
            raise ConfigError(f"numbers.url: {self._settings.numbers.url}: {wrong}")

    # storing

    def _store(self, messages: Sequence[Message], ended: threading.Event) -> bool:
        """Store what messages say; try until it is done. Returns False when the end came before."""
        began_s, pause_s = time.monotonic(), RETRY_FIRST_S
        batch = self._sort(messages)
        while not ended.is_set():
            try:
                written = self._writer.write(batch)
            except (NumbersError, SQLAlchemyError) as error:
                _say(f"{plain(str(error))}; again in {pause_s:g} s")
                self._notifier.alive(plain(str(error)))
                ended.wait(pause_s)
                pause_s = min(2 * pause_s, RETRY_MAX_S)
            else:
                self._tell(written.refused)
                self._note(messages, written, began_s)
                return True
        return False

    def _sort(self, messages: Sequence[Message]) -> Batch:
        now = time.time()
        oldest = now - self._settings.numbers.retention_days * DAY_S
        batch = Batch(Times(now, time.monotonic(), oldest))
        for message in messages:
            ledger = self._ledger(message.rig)
            if ledger is None:
                why = f"{plain(message.rig, 80)!r} is not a rig's name, or there are too many"
                batch.refused.append(("", Refused("rig", why)))
            else:
                batch.hear(message, ledger)
        return batch

    def _ledger(self, rig: str) -> RigLedger | None:
        own = self._settings.ingest
        if rig not in self._ledgers and len(self._ledgers) < own.rigs_max and re.fullmatch(NAME, rig):
            self._ledgers[rig] = RigLedger(own.gap_wait_s)
        return self._ledgers.get(rig)

    # telling

    def _tell(self, refused: RigRefusals) -> None:
        for rig, error in refused:
            if self._allowance.take():
                _say(f"{rig or 'no rig'}: refused, {error.reason}: {error}")

    def _note(self, messages: Sequence[Message], written: BatchReport, began_s: float) -> None:
        if self._journal is None:
            return
        now = time.monotonic()
        lags = [round(now - message.heard_s, 3) for message in messages if message.what == "history/tick"]
        line = {
            "utc": round(time.time(), 3),
            "messages": len(messages),
            "stored": written.ticks,
            "store_s": round(now - began_s, 4),
            "numbers_s": round(written.numbers_s, 4),
            "database_s": round(written.database_s, 4),
            "lags_s": lags,
        }
        with self._journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def _check(self) -> None:
        """Tell when VictoriaMetrics has dropped samples: it says so in its counters alone.

        Errors : ConfigError where it was started anew with options that lose ticks
        """
        if time.monotonic() < self._check_at_s:
            return
        self._check_at_s = time.monotonic() + CHECK_S
        try:
            self._check_options()
            dropped = self._numbers.dropped_rows()
        except NumbersError:
            return  # the next batch meets it too, and tells it
        total = sum(dropped.values())
        if total > self._dropped:
            _say(f"VictoriaMetrics has dropped {total:.0f} samples since its start: {', '.join(dropped)}")
        self._dropped = total

    # asking

    def _ask(self) -> None:
        """Ask rigs for what is missing, but not while messages wait here: it may be among them."""
        now = time.monotonic()
        if now < self._look_at_s or self._is_behind or not self._inbox.is_connected:
            return
        free = ASKS_MAX - sum(ledger.asks.ask is not None for ledger in self._ledgers.values())
        for rig, ledger in self._ledgers.items():
            if ledger.is_online and (free > 0 or ledger.asks.ask is not None):
                span = ledger.asks.look(ledger.missing(), now)
                if span is not None:
                    free -= 1
                    self._inbox.ask(rig, "resend", json.dumps({"first_seq": span[0], "last_seq": span[1]}))
        took_s = time.monotonic() - now
        self._look_at_s = now + max(LOOK_S, took_s / LOOK_SHARE)


def _names(books: Books) -> set[str]:
    try:
        return books.names()
    except SQLAlchemyError as error:
        raise DataError(f"database.url: rigs can't be read: {plain(str(error))}") from None


def _say(text: str) -> None:
    print(f"ingest: {text}", file=sys.stderr, flush=True)
