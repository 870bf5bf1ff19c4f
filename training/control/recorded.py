"""A tick in the history before the next one begins, for controllers that read it."""

import sqlite3
import time
from contextlib import closing
from pathlib import Path

WRITTEN_S = 10.0


def wait_recorded(history: Path, seq: int) -> None:
    """Until the tick `seq` is in the history, at most WRITTEN_S.

    On a rig a minute lies between a tick and the next question. In lock-step it is some milliseconds, and
    what a model reads would depend on how fast the disk is: two runs with one seed would differ.
    """
    give_up = time.monotonic() + WRITTEN_S
    with closing(sqlite3.connect(history)) as reader:
        while not reader.execute("SELECT 1 FROM ticks WHERE seq = ?", (seq,)).fetchone():
            if time.monotonic() > give_up:
                return
            time.sleep(0.001)
