"""A lock over all machines of one database: one process alone does a work, and the next when it has died.

No clock of another machine is asked: who waits looks whether the holder's beat still rises, by its own clock.
A holder that was thought dead and is not finds out by `check`, in the transaction that it would write.
"""

import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from sqlalchemy import CursorResult, Engine, insert, update
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from sqlalchemy.orm import Session

from edge.core.errors import GreenhouseError
from fleet.database.tables import MACHINE_MAX, WorkLease

LEASE_S = 60.0  # without a beat, after which a holder of another machine is taken for dead
BEAT_S = 10.0
POLL_S = 2.0


class LeaseLost(GreenhouseError):
    """Another process does the work now."""


class FleetLease:
    """The right to do a work. lease_s : as LEASE_S. Errors: SQLAlchemyError from every method"""

    def __init__(self, engine: Engine, work: str, lease_s: float = LEASE_S) -> None:
        self._engine, self._work, self._lease_s = engine, work, lease_s
        self._own = {
            "holder": uuid.uuid4().hex,
            "machine": _machine(),
            "host": socket.gethostname()[:MACHINE_MAX],
            "pid": os.getpid(),
        }
        self._seen: tuple[str, int] | None = None  # holder and beat, and since when they have stood still
        self._seen_s = 0.0

    def take(self) -> str:
        """Take the work where nobody who lives has it; return who has it, "" for this object."""
        with Session(self._engine) as session:
            row = session.get(WorkLease, self._work)
        if row is None:
            return self._make()
        if row.holder == self._own["holder"]:
            return ""
        if (row.holder, row.beat) != self._seen:
            self._seen, self._seen_s = (row.holder, row.beat), time.monotonic()
        is_still = time.monotonic() - self._seen_s >= self._lease_s
        if (not row.holder or is_still or _has_ended(row)) and self._replace(row):
            return ""
        return f"process {row.pid} of {row.host}"

    def wait(
        self,
        ended: threading.Event,
        say: Callable[[str], None],
        look: Callable[[str], None] = lambda _: None,
    ) -> bool:
        """Return once it is taken, False where the end came before.

        say, look : are told who has it meanwhile, once and at every look
        """
        said = ""
        while not ended.is_set():
            holder = self.take()
            if not holder:
                return True
            if holder != said:
                say(f"{holder} does {self._work}; this one waits until it ends")
            said = holder
            look(f"waits for {holder}")
            ended.wait(min(POLL_S, self._lease_s / 2))
        return False

    def check(self, session: Session) -> None:
        """Make sure that what a transaction writes is the holder's. Errors: LeaseLost"""
        own = (WorkLease.work == self._work, WorkLease.holder == self._own["holder"])
        # A write, not a look: whoever would take the work waits for the end of this transaction.
        changed = session.execute(update(WorkLease).where(*own).values(beat=WorkLease.beat + 1))
        if cast(CursorResult[Any], changed).rowcount != 1:
            raise LeaseLost(f"{self._work}: another process does it now")

    @contextmanager
    def keep(self) -> Iterator[None]:
        """Beat in a thread of its own, and give the work back at the end."""
        ended = threading.Event()
        thread = threading.Thread(target=self._beat, args=(ended,), name="lease")
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
            with suppress(SQLAlchemyError):  # it is away: the next one sees that the beat stands still
                self.give_back()

    def give_back(self) -> None:
        """Let the next one have it at once; nothing happens where another one has it."""
        own = (WorkLease.work == self._work, WorkLease.holder == self._own["holder"])
        with Session(self._engine) as session, session.begin():
            session.execute(update(WorkLease).where(*own).values(holder=""))

    def _beat(self, ended: threading.Event) -> None:
        while not ended.wait(min(BEAT_S, self._lease_s / 4)):
            try:
                with Session(self._engine) as session, session.begin():
                    self.check(session)
            except LeaseLost:
                return  # the work meets it too, and tells it
            except SQLAlchemyError:
                continue  # likewise; the database may be back at the next beat

    def _make(self) -> str:
        try:
            with Session(self._engine) as session, session.begin():
                session.execute(insert(WorkLease).values(work=self._work, beat=0, **self._own))
        except IntegrityError:
            return self.take()  # another one was first
        return ""

    def _replace(self, row: WorkLease) -> bool:
        seen = (
            WorkLease.work == row.work,
            WorkLease.holder == row.holder,
            WorkLease.beat == row.beat,
        )
        with Session(self._engine) as session, session.begin():
            changed = session.execute(update(WorkLease).where(*seen).values(beat=row.beat + 1, **self._own))
            return cast(CursorResult[Any], changed).rowcount == 1


def _machine() -> str:
    """Return where process ids are those of this process: a boot of a machine, and a container there."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return f"{boot} {Path('/proc/self/ns/pid').readlink()}"[:MACHINE_MAX]


def _has_ended(row: WorkLease) -> bool:
    """Return whether its process is known to be dead; one of another machine never is."""
    if row.machine != _machine():
        return False
    try:
        os.kill(row.pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False  # another user's
    return False
