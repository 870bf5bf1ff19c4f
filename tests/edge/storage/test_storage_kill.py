"""kill -9 at any moment: the file stays whole, and what is missing is visible."""

import random
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from history_records import HandClock, History

from edge.storage import Storage

pytestmark = pytest.mark.slow

KILLS = 12
QUEUE_TICKS = 50

# Says the number of each tick that it knows to be written, as the loop would know it.
DAEMON = """
import sys
from pathlib import Path
sys.path[:0] = [sys.argv[2]]
from history_records import HandClock, History, tick
from edge.storage import Outbox, Storage

storage = Storage(History.at(Path(sys.argv[1]), queue_ticks=50), HandClock())
seq = storage.open()
written = seq - 1
print("first", seq, [event.key for event in storage.events_pending()], flush=True)
while True:
    storage.write(tick(seq))
    if storage.wait_written(seq, 5 if seq % 7 == 0 else 0):
        written = seq
    print("given", seq, written, flush=True)
    seq += 1
"""


def killed_daemon(path: Path, lines: int) -> list[list[str]]:
    """Run a writer, kill it when it has said `lines` lines; returns all that it said, in words."""
    root = Path(__file__).parents[3]
    process = subprocess.Popen(
        [sys.executable, "-c", DAEMON, str(path), str(root / "tests" / "support")],
        cwd=root,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    said = []
    try:
        for line in process.stdout:
            said.append(line.split(maxsplit=2))
            if len(said) >= lines:
                break
    finally:
        process.send_signal(signal.SIGKILL)
        said += [line.split(maxsplit=2) for line in process.stdout if line.endswith("\n")]
        process.wait(10)
        process.stdout.close()
    return said


def test_kills_at_random_moments_leave_a_whole_file_and_visible_gaps(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    random_lines = random.Random(7)
    given: set[int] = set()
    acknowledged: set[int] = set()
    for kill in range(KILLS):
        said = killed_daemon(path, random_lines.choice((1, 2, 5, 20, 100, 300)))
        first = int(said[0][1])
        assert first > max(given, default=0), "a number was given twice"
        assert ("history.unclean_stop" in said[0][2]) == (kill > 0)
        given |= {int(words[1]) for words in said[1:]}
        if len(said) > 1:
            acknowledged |= set(range(first, int(said[-1][2]) + 1))
        with closing(sqlite3.connect(path)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            stored = {seq for (seq,) in connection.execute("SELECT seq FROM ticks")}
            # Each of a tick's rows is there or none is, and its message with it.
            for table in ("readings", "decisions", "outbox"):
                assert {seq for (seq,) in connection.execute(f"SELECT seq FROM {table}")} == stored
        assert acknowledged <= stored, "a tick that was said to be written is missing"
    storage = Storage(History.at(path, queue_ticks=QUEUE_TICKS), HandClock())
    storage.open()
    assert storage.close(20.0)
    with closing(sqlite3.connect(path)) as connection:
        gaps = connection.execute("SELECT first_seq, last_seq FROM gaps").fetchall()
    assert len(gaps) == KILLS
    for seq in given - stored:
        assert any(first <= seq <= last for first, last in gaps)
