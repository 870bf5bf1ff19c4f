"""Trials that have nothing to do with each other, shared out among processes.

Each is computed alike wherever it is computed, so the number of processes changes the time and nothing else.
"""

import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, get_context, parent_process
from types import TracebackType
from typing import TypeVar

Item = TypeVar("Item")
Found = TypeVar("Found")
AT_ONCE = 30_000  # rows of all trials of one lot together, as each row of a trial takes about 1 kB


class SideBySide:
    """Functions of lots of items; this process takes its share, and all of it once the others have ended.

    jobs : processes, this one included; rows : of all runs together, which bound the size of a lot
    """

    def __init__(self, jobs: int = 1, rows: int = 1) -> None:
        self._most = max(1, AT_ONCE // max(rows, 1))
        self._others: ProcessPoolExecutor | None = None
        self._jobs = max(1, jobs)
        if self._jobs > 1:
            # By fork, as every other way imports SciPy again; a diagnosis has no thread of its own.
            self._others = ProcessPoolExecutor(self._jobs - 1, get_context("fork"), _end_with_parent)

    def __enter__(self) -> "SideBySide":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._others is not None:
            self._others.shutdown(cancel_futures=True)
            self._others = None

    def map(
        self, function: Callable[[Sequence[Item]], Sequence[Found]], items: Sequence[Item]
    ) -> list[Found]:
        """Return `function` of each item, in their order.

        function : can be pickled, and makes of an item the same in every lot
        """
        count = max(min(self._jobs, len(items)), -(-len(items) // self._most))
        lots = [items[i::count] for i in range(count)]
        found = self._of_lots(function, lots)
        return [found[i % count][i // count] for i in range(len(items))]

    def _of_lots(
        self, function: Callable[[Sequence[Item]], Sequence[Found]], lots: Sequence[Sequence[Item]]
    ) -> list[Sequence[Found]]:
        if self._others is not None:
            try:
                return self._share(self._others, function, lots)
            except BrokenProcessPool:  # one was killed, as for its memory: later alone is better than never
                self._others.shutdown()
                self._others = None
        return [function(lot) for lot in lots]

    def _share(
        self,
        others: ProcessPoolExecutor,
        function: Callable[[Sequence[Item]], Sequence[Found]],
        lots: Sequence[Sequence[Item]],
    ) -> list[Sequence[Found]]:
        theirs = {i: others.submit(function, lot) for i, lot in enumerate(lots) if i % self._jobs}
        mine = {i: function(lot) for i, lot in enumerate(lots) if i not in theirs}
        return [theirs[i].result() if i in theirs else mine[i] for i in range(len(lots))]


def _end_with_parent() -> None:
    """End a worker on an interrupt, silently, and when its parent dies."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
