"""python -m bench.diagnosis_memory: what a nightly diagnosis takes of a history of so many days.

The history is simulated by the default bundle's twin, which so lacks nothing, or lacks a loss through the
wall; stuck readings stand still for some minutes. Peak resident memory and CPU time of `greenhouse twin
diagnose` with one process, with the rows that the nightly one takes and with all.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from bench.history_year import head
from edge.app.nightly_diagnosis import ROWS_MAX
from edge.formats.run_file import RecordedRun
from edge.storage.file import connect
from edge.twin.twin_file import read_twin_file
from tests.support.simulated_runs import simulate

TWIN = Path("edge/models/default_bundle/twin.yaml")
FIRST_UTC = 1_767_225_600.0
DAY_ROWS = 1440
CASES = {  # name: stuck readings, effects that the twin lacks
    "clean": (0, {}),
    "ten stuck readings": (10, {}),
    "a loss through the wall": (0, {"wall_loss": {"UA": 3.0}}),
}


def record_run(days: float, stuck: int, lacking: dict[str, dict[str, float]]) -> RecordedRun:
    """Return a run of 60 s steps."""
    own = read_twin_file(TWIN).effects.items()
    effects = {name: {key: value.value for key, value in values.items()} for name, values in own}
    run = simulate({**effects, **lacking}, seed=1, rows=round(days * DAY_ROWS))
    draw, temp = np.random.default_rng(3), run.columns["temp_air_c"]
    for begin in draw.integers(60, len(run) - 60, stuck):
        temp[begin : begin + draw.integers(10, 30)] = temp[begin]
    return run


def write_history(path: Path, run: RecordedRun) -> None:
    """Write the run as ticks of one session."""
    columns = {key: values.tolist() for key, values in run.columns.items()}
    seqs = range(1, len(run) + 1)
    # Straight into the tables: through the daemon's own writer two weeks would take minutes.
    with closing(connect(path, 1.0)) as connection:
        connection.execute("BEGIN")
        connection.execute(
            "INSERT INTO sessions (session, first_seq, started_utc) VALUES (1, 1, ?)", (FIRST_UTC,)
        )
        connection.executemany(
            "INSERT INTO ticks (seq, session, utc, step_s, controller, echo_trip_cause, echo_heater_duty,"
            " echo_fan_on, echo_led, ticks_skipped) VALUES (?, 1, ?, 60, 'MPC-P', '', ?, ?, 0, 0)",
            zip(
                seqs,
                (FIRST_UTC + 60.0 * seq for seq in seqs),
                columns["heater_duty"],
                columns["fan_on"],
                strict=True,
            ),
        )
        for key in ("temp_air_c", "temp_ambient_c"):
            connection.executemany(
                "INSERT INTO readings VALUES (?, ?, ?, 'good')",
                ((seq, key, value) for seq, value in zip(seqs, columns[key], strict=True)),
            )
        connection.execute("COMMIT")


def diagnose_once(history: Path, folder: Path, rows: int | None) -> tuple[float, float]:
    """Peak resident memory [MB] and CPU time [s] of one diagnosis."""
    words = ["--jobs", "1", "--history", str(history), "--twin", str(TWIN), "--out", str(folder / "report")]
    bound = [] if rows is None else ["--rows", str(rows)]
    # A process between, whose only child it is: the maximum over children is then its own.
    program = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=-3);"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN); print(used.ru_maxrss, used.ru_utime)"
    )
    command = [
        sys.executable,
        "-c",
        program,
        sys.executable,
        "-m",
        "edge",
        "twin",
        "diagnose",
        *words,
        *bound,
    ]
    out = subprocess.run(
        command,
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ).stdout.split()
    return int(out[0]) / 1024, float(out[1])


def report(days: float) -> Iterator[str]:
    """Yield the table, line by line as it comes."""
    yield head()
    yield f"{f'{days:g} days of 60 s':28} {'rows':>8} {'peak [MB]':>10} {'CPU [s]':>8}"
    for name, (stuck, lacking) in CASES.items():
        with tempfile.TemporaryDirectory(prefix="gh-") as folder:
            history = Path(folder) / "history.db"
            write_history(history, record_run(days, stuck, lacking))
            for rows in (ROWS_MAX, None):
                peak, cpu = diagnose_once(history, Path(folder), rows)
                yield f"{name:28} {rows or 'all':>8} {peak:10.0f} {cpu:8.0f}"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.diagnosis_memory", description=__doc__)
    parser.add_argument("--days", type=float, default=14.0, help="usual: as drift.diagnose_since_d")
    arguments = parser.parse_args()
    print(f"python -m bench.diagnosis_memory {' '.join(sys.argv[1:])}")
    for line in report(arguments.days):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
