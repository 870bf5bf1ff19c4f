"""edge/diagnosis/side_by_side.py: lots shared out among processes, in order, and none left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from edge.core.processes import processors
from edge.diagnosis.side_by_side import AT_ONCE, SideBySide
from tests.support.simulated_runs import BOX, candidates_only, search_over, simulate

pytestmark = pytest.mark.slow

PARENT = os.getpid()
RUNS = [simulate({**BOX, "heater_lag": {"tau_h": 240.0}}, seed, 60) for seed in (1, 2)]


def doubled(lot: Sequence[int]) -> list[int]:
    return [2 * item for item in lot]


def sizes(lot: Sequence[int]) -> list[int]:
    return [len(lot)] * len(lot)


def processes(lot: Sequence[int]) -> list[int]:
    return [os.getpid()] * len(lot)


def killed_elsewhere(lot: Sequence[int]) -> list[int]:
    if os.getpid() != PARENT:
        os.kill(os.getpid(), signal.SIGKILL)
    return doubled(lot)


def failing(lot: Sequence[int], at: int) -> list[int]:
    if at in lot:
        raise ZeroDivisionError(f"at {at}")
    return doubled(lot)


@pytest.mark.parametrize("jobs", [1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_what_is_found_comes_in_the_order_of_the_items(jobs: int, count: int) -> None:
    with SideBySide(jobs) as shared:
        assert shared.map(doubled, list(range(count))) == [2 * item for item in range(count)]


def test_one_process_takes_all_and_two_share() -> None:
    with SideBySide(1) as alone, SideBySide(2) as shared:
        assert alone.map(processes, [0, 1, 2]) == [PARENT] * 3
        assert len(set(shared.map(processes, [0, 1, 2]))) == 2


@pytest.mark.parametrize(("rows", "most"), [(1, 9), (AT_ONCE // 4, 4), (AT_ONCE, 1), (10 * AT_ONCE, 1)])
def test_a_lot_has_no_more_rows_than_fit(rows: int, most: int) -> None:
    found = SideBySide(1, rows).map(sizes, list(range(9)))
    assert max(found) <= most < 10
    assert len(found) == 9


def test_when_a_process_is_killed_the_rest_is_done_here() -> None:
    with SideBySide(2) as shared:
        assert shared.map(killed_elsewhere, [1, 2, 3]) == [2, 4, 6]
        assert shared.map(processes, [1, 2]) == [PARENT, PARENT]


def test_what_comes_after_the_end_is_done_here() -> None:
    with SideBySide(2) as shared:
        pass
    assert shared.map(processes, [1, 2, 3]) == [PARENT] * 3


@pytest.mark.parametrize("at", [0, 1])
def test_an_error_comes_back_from_either_process(at: int) -> None:
    with SideBySide(2) as shared, pytest.raises(ZeroDivisionError, match=f"at {at}"):
        shared.map(partial(failing, at=at), [0, 1])


def test_no_process_outlives_one_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "shares.py"
    script.write_text(
        "import os, time\n"
        "from edge.diagnosis.side_by_side import SideBySide\n"
        "def pids(lot):\n"
        "    return [os.getpid()] * len(lot)\n"
        "print(*SideBySide(2).map(pids, [0, 1]), flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        other = next(int(pid) for pid in process.stdout.readline().split() if int(pid) != process.pid)
        process.kill()
    deadline = time.monotonic() + 10.0
    while Path(f"/proc/{other}").exists() and _runs(other) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _runs(other)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_the_number_of_processes_changes_no_answer() -> None:
    found = []
    for jobs in (1, 2):
        with SideBySide(jobs) as shared, candidates_only("heater_lag", "sensor_lag", "infiltration"):
            search, _ = search_over(RUNS, shared=shared)
            best = search.missing()
        found.append((best.added, best.score, best.fit.file.values(), best.fit.trial.levels))
    assert found[0] == found[1]


def test_there_is_at_least_one_processor() -> None:
    assert 1 <= processors() <= (os.cpu_count() or 1)
