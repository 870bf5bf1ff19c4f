"""The one executor behind every sweep: the same function over many jobs, on this machine or on a cluster.

Local jobs run in spawned processes. With the address of a dask scheduler (`--dask tcp://host:8786`) they run
on its workers, which need this software, the same folders, and one thread each. The results are the same:
BLAS takes one thread in both, and a job knows nothing of the others.
"""

import argparse
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, TypeVar

from edge.core.errors import GreenhouseError
from edge.core.processes import die_with_parent

Job = TypeVar("Job")
Result = TypeVar("Result")
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_is_working = False  # in a worker: a job runs
POLL_S = 0.5  # between two looks for a signal
CONNECT_S = 10.0
PATIENCE_S = 20.0  # for a job to clean up behind itself
ENDING = (signal.SIGINT, signal.SIGTERM)


class SweepError(GreenhouseError):
    """A job failed; the text names the job with its arguments, and the reason."""


def add_arguments(parser: argparse.ArgumentParser, workers: int = 2) -> None:
    """Add `--workers` and `--dask`."""
    parser.add_argument("--workers", type=int, default=workers, help="processes (usual: %(default)s)")
    parser.add_argument("--dask", metavar="ADDRESS", help="run on this dask scheduler, e.g. tcp://host:8786")


def sweep(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int = 2,
    dask: str | None = None,
    progress: Callable[[int, Job, Result], None] = lambda done, job, result: None,
) -> list[Result]:
    """Return the result of each job, in the order of the jobs.

    workers : processes on this machine; 0 runs all jobs here, one after the other
    dask : address of a scheduler, in place of processes
    progress : called as jobs end, with how many have ended
    Errors : SweepError for the first job that fails; the others are ended. KeyboardInterrupt on a signal
    """
    results: dict[int, Result] = {}

    def take(number: int, result: Result) -> None:
        results[number] = result
        progress(len(results), jobs[number], result)

    if jobs and dask is not None:
        _on_cluster(function, jobs, dask, take)
    elif jobs and workers:
        _on_processes(function, jobs, workers, take)
    else:
        for number, job in enumerate(jobs):
            with _name_job(function, job):
                result = function(job)
            take(number, result)
    # In the jobs' order, however they ended: any number of workers gives the same.
    return [results[number] for number in range(len(jobs))]


def _on_processes(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    take: Callable[[int, Result], None],
) -> None:
    with _signals_kept() as ended_by, _one_blas_thread():
        pool = ProcessPoolExecutor(min(workers, len(jobs)), get_context("spawn"), _begin_worker)
        try:
            waiting = {pool.submit(_run, function, job): number for number, job in enumerate(jobs)}
            while waiting:
                done, _ = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
                if ended_by:
                    raise KeyboardInterrupt
                for future in sorted(done, key=waiting.__getitem__):
                    number = waiting.pop(future)
                    with _name_job(function, jobs[number]):
                        result = future.result()
                    take(number, result)
        except BaseException:
            _end(pool)
            raise
        pool.shutdown()


def _on_cluster(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    address: str,
    take: Callable[[int, Result], None],
) -> None:
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise GreenhouseError("--dask: not installed: pip install distributed") from error
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError as error:
        raise GreenhouseError(f"--dask {address}: no scheduler answers: {error}") from error
    with client, client.as_current():
        waiting: dict[Any, int] = {
            client.submit(function, job, pure=False): number for number, job in enumerate(jobs)
        }
        try:
            for future in as_completed(list(waiting)):
                with _name_job(function, jobs[waiting[future]]):
                    result = future.result()
                take(waiting[future], result)
        finally:
            client.cancel(list(waiting))


def _run(function: Callable[[Job], Result], job: Job) -> Result:
    """Do a job in a worker. A job that a signal has ended is the worker's last: none follows it."""
    global _is_working
    _is_working = True
    try:
        return function(job)
    except Exception:
        raise
    except BaseException:
        os._exit(1)
    finally:
        _is_working = False


def _begin_worker() -> None:
    die_with_parent()
    for each in ENDING:
        signal.signal(each, _leave)


def _leave(number: int, frame: object) -> None:
    """On a signal: a job cleans up behind itself first."""
    if _is_working:
        raise KeyboardInterrupt
    os._exit(1)


def _end(pool: ProcessPoolExecutor) -> None:
    """End the workers and what they run; `shutdown` alone would wait for their jobs."""
    processes = list((pool._processes or {}).values())
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(PATIENCE_S)
        process.kill()
    pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _name_job(function: Callable[..., Any], job: object) -> Iterator[None]:
    try:
        yield
    except Exception as error:
        name = getattr(getattr(function, "func", function), "__name__", repr(function))  # `func`: a partial's
        raise SweepError(f"{name}({job}): {type(error).__name__}: {error}") from error


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """In the processes that are started meanwhile: BLAS reads the environment when it is imported."""
    before = dict(os.environ)
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    try:
        yield
    finally:
        for name in set(BLAS_THREADS) - before.keys():
            del os.environ[name]


@contextmanager
def _signals_kept() -> Iterator[list[int]]:
    """Ctrl-C and SIGTERM wait in this list: amid a start they would leave a process that nobody ends."""
    kept: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # signals are for the main thread alone
        yield kept
        return
    before = {each: signal.signal(each, lambda number, _: kept.append(number)) for each in ENDING}
    try:
        yield kept
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
