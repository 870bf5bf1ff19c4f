"""A batch in the stores: the numbers first, then all that the database has of it, in one transaction."""

import time
from collections.abc import MutableMapping
from dataclasses import dataclass

from edge.core.plain_text import plain
from fleet.ingest.batch import Batch
from fleet.ingest.books import Books, Entry
from fleet.ingest.ledger import RigLedger, RigPlan
from fleet.ingest.spans import Refused
from fleet.ingest.tick import Tick
from fleet.numbers.series import lines
from fleet.numbers.victoria import Numbers

RigRefusals = list[tuple[str, Refused]]


@dataclass(frozen=True, slots=True)
class BatchReport:
    """A batch that is stored. numbers_s, database_s : what both stores took; ticks : that were new"""

    numbers_s: float
    database_s: float
    ticks: int
    refused: RigRefusals


class BatchWriter:
    """Writes batches, and lets the ledgers be what is stored.

    Errors : NumbersError, SQLAlchemyError; the same batch may be written again then
    """

    def __init__(self, numbers: Numbers, books: Books, ledgers: MutableMapping[str, RigLedger]) -> None:
        self._numbers, self._books, self._ledgers = numbers, books, ledgers

    def write(self, batch: Batch) -> BatchReport:
        """Return once the numbers are on disk and the transaction is through."""
        try:
            return self._write(batch)
        except Exception:
            # What the database has is not known after a commit without an answer: it is read again.
            for rig in batch.rigs:
                self._ledgers[rig].is_loaded = False
            raise

    def _write(self, batch: Batch) -> BatchReport:
        start_s = time.monotonic()
        self._load(batch)
        plans, refused = self._plan(batch)
        fresh = [tick for rig_plan in plans.values() for tick in rig_plan[1]]
        loaded_s = time.monotonic()
        if fresh:
            self._numbers.store("".join([lines(tick.rig, tick.utc, tick.samples) for tick in fresh]))
        stored_s = time.monotonic()
        self._books.write(self._entry(batch, plans, fresh, refused))
        for plan, _ in plans.values():
            plan.settle()
        for rig in batch.gone:  # its rows may be erased from now on, and it may come again
            self._ledgers[rig].is_loaded = False
        database_s = time.monotonic() - stored_s + loaded_s - start_s
        return BatchReport(stored_s - loaded_s, database_s, len(fresh), refused)

    def _load(self, batch: Batch) -> None:
        wanted = [rig for rig in batch.rigs if not self._ledgers[rig].is_loaded]
        if wanted:
            for rig, histories in self._books.histories(wanted).items():
                self._ledgers[rig].load(histories)

    def _plan(self, batch: Batch) -> tuple[dict[str, tuple[RigPlan, list[Tick]]], RigRefusals]:
        """Return by rig what its histories will be with its new ticks, and all that is refused."""
        plans: dict[str, tuple[RigPlan, list[Tick]]] = {}
        refused = list(batch.refused)

        def plan_of(rig: str) -> tuple[RigPlan, list[Tick]]:
            return plans.setdefault(rig, (RigPlan(self._ledgers[rig]), []))

        for tick in batch.ticks:
            plan, fresh = plan_of(tick.rig)
            try:
                new = plan.take(tick)
            except Refused as error:
                refused.append((tick.rig, error))
            else:
                fresh += [] if new is None else [new]
        for rig, lie in batch.refused:
            if lie.seq:
                plan_of(rig)[0].give_up(lie.history_id, (lie.seq, lie.seq))
        for rig, history_id, span in batch.absent:
            plan_of(rig)[0].give_up(history_id, span)
        return plans, refused

    def _entry(
        self,
        batch: Batch,
        plans: dict[str, tuple[RigPlan, list[Tick]]],
        fresh: list[Tick],
        refused: RigRefusals,
    ) -> Entry:
        spans = {rig: (self._ledgers[rig].histories, plan.histories) for rig, (plan, _) in plans.items()}
        entry = Entry(batch.times.utc, batch.rigs, spans, fresh, batch.twins, batch.gone)
        for rig, error in refused:
            entry.refused[rig, error.reason] += 1
            entry.texts[rig, error.reason] = plain(str(error), 500)
        return entry
