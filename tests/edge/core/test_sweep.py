"""edge/core/sweep.py: jobs on processes and on a cluster give what they give one after the other."""

import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from edge.core import sweep as executor
from edge.core.sweep import SweepError, sweep
from training.evaluate.fresh_runs import keep


def told(job):
    """The first job ends last."""
    time.sleep(3.0 if job == 0 else 0.0)  # longer than a busy machine takes to start the second process
    if job == 3:
        raise ValueError("three is too many")
    return job, os.getpid(), os.environ["OMP_NUM_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]


def sleep(folder):
    (folder / str(os.getpid())).touch()
    time.sleep(60.0)


@pytest.mark.slow
def test_results_keep_the_order_of_the_jobs_and_progress_that_of_their_ends(monkeypatch):
    for name in executor.BLAS_THREADS:
        monkeypatch.delenv(name, raising=False)
    progress = []
    found = sweep(told, [0, 1, 2], 2, progress=lambda done, job, result: progress.append((done, job)))
    assert [one[0] for one in found] == [0, 1, 2]
    assert [done for done, _ in progress] == [1, 2, 3]
    assert progress[-1][1] == 0
    assert os.getpid() not in {one[1] for one in found}
    assert {one[2:] for one in found} == {("1", "1")}
    assert not os.environ.keys() & set(executor.BLAS_THREADS)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_failed_job_is_named_with_its_arguments(workers, monkeypatch):
    for name in executor.BLAS_THREADS:
        monkeypatch.setenv(name, "1")
    with pytest.raises(SweepError, match=r"^told\(3\): ValueError: three is too many$"):
        sweep(told, [1, 3], workers)


@pytest.mark.slow
@pytest.mark.parametrize("number", executor.ENDING)
def test_a_signal_in_the_middle_of_a_start_leaves_no_process_behind(number, tmp_path, monkeypatch):
    class Interrupted(ProcessPoolExecutor):
        def submit(self, *words):
            future = super().submit(*words)
            while not list(tmp_path.iterdir()):  # it sleeps
                time.sleep(0.05)
            os.kill(os.getpid(), number)
            return future

    monkeypatch.setattr(executor, "ProcessPoolExecutor", Interrupted)
    handler = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt):
        sweep(sleep, [tmp_path], 1)
    (started,) = tmp_path.iterdir()
    assert not Path(f"/proc/{started.name}").exists()
    assert signal.getsignal(number) is handler


@pytest.mark.slow
def test_no_scheduler_at_the_address_is_said_in_a_line(monkeypatch):
    monkeypatch.setattr(executor, "CONNECT_S", 0.2)
    with pytest.raises(executor.GreenhouseError, match="no scheduler answers"):
        sweep(told, [1], dask="tcp://127.0.0.1:9")


@pytest.mark.slow
def test_a_cluster_makes_the_files_that_processes_make(tmp_path):
    from distributed import LocalCluster

    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    seeds = (1000, 1001)
    sweep(keep, [("calibration", seed, here) for seed in seeds], 2)
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://")
        sweep(keep, [("calibration", seed, there) for seed in seeds], dask=address)
        with pytest.raises(SweepError, match=r"^keep\(\('none', 1, .*KeyError"):
            sweep(keep, [("none", 1, there)], dask=address)
    names = sorted(path.name for path in here.iterdir())
    assert len(names) == 2
    assert [(there / name).read_bytes() for name in names] == [(here / name).read_bytes() for name in names]
