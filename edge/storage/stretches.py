"""The rig's own history as runs that a model may be fitted on: one a session, runs of role test apart."""

import sqlite3
from itertools import groupby
from pathlib import Path

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.storage.runs import reading
from edge.storage.ticks_as_run import Tick, run_of_ticks, ticks_between


def export_stretches(
    path: str | Path, since_utc: float | None = None, until_utc: float | None = None
) -> list[RecordedRun]:
    """Return the rig's recordings between two times, in their order, without imported runs.

    From session to session only the wall clock could tell how much time passed, so none crosses one. Ticks
    of a named run of role test are stretches of their own and carry that role. Inputs are as `export_run`'s:
    what the board confirmed, so what was sent after safety and not what was wanted.

    Errors : DataError
    """
    with reading(path) as connection:
        ticks = ticks_between(connection, None, None, since_utc, until_utc)
        if not ticks:
            raise DataError(f"{path}: there are no ticks in this stretch")
        tests = _test_runs(connection)

        def kind(tick: Tick) -> tuple[object, tuple[int, int] | None]:
            return tick[1], next((run for run in tests if run[0] <= tick[0] <= run[1]), None)

        return [
            run_of_ticks(connection, path, list(rows), {"role": "test"} if test else {})
            for (_, test), rows in groupby(ticks, kind)
        ]


def _test_runs(connection: sqlite3.Connection) -> list[tuple[int, int]]:
    return connection.execute(
        "SELECT first_seq, last_seq FROM runs WHERE lower(trim(role)) = 'test' ORDER BY first_seq"
    ).fetchall()
