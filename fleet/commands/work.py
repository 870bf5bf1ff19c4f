"""`greenhouse fleet work`: the jobs of a night, once or each night."""

import argparse
import signal
import sys
import threading
import time
from datetime import datetime, timedelta

from sqlalchemy import Engine

from edge.core.errors import GreenhouseError, RequestError
from edge.core.sweep import add_arguments as add_sweep_arguments
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.settings import FleetSettings

WORK = "the jobs of a night"  # of the lease


def add_work_arguments(parser: argparse.ArgumentParser) -> None:
    """Add when and where the jobs run."""
    parser.add_argument(
        "--at", type=_time_of_day, metavar="HH:MM", help="each day at this time (usual: once, now)"
    )
    add_sweep_arguments(parser, workers=1)


def _time_of_day(text: str) -> tuple[int, int]:
    try:
        found = datetime.strptime(text, "%H:%M")
    except ValueError:
        raise RequestError(f"--at: {text!r} is no time like 03:00") from None
    return found.hour, found.minute


def run_work(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Do the jobs and say what came of each. Errors: DataError, SweepError"""
    if arguments.at is None:
        _work(settings, arguments.workers, arguments.dask)
        return 0
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    while not ended.wait(seconds_until(arguments.at, datetime.now())):
        try:
            _work(settings, arguments.workers, arguments.dask)
        except GreenhouseError as error:  # told; the next night tries again
            print(f"work: {error}", file=sys.stderr, flush=True)
    return 0


def seconds_until(at: tuple[int, int], now: datetime) -> float:
    """Return how long it is to the next time of day `at`, more than nothing."""
    then = now.replace(hour=at[0], minute=at[1], second=0, microsecond=0)
    return (then - now + timedelta(days=then <= now)).total_seconds()


def _work(settings: FleetSettings, workers: int, dask: str | None) -> None:
    engine = open_database(settings.database)
    try:
        lease = FleetLease(engine, WORK)
        if holder := lease.take():
            raise RequestError(f"{holder} does {WORK} now: call it again when that has ended")
        with lease.keep():
            _do(settings, engine, workers, dask)
    finally:
        engine.dispose()  # the service calls this each night


def _do(settings: FleetSettings, engine: Engine, workers: int, dask: str | None) -> None:
    # Late: fits take 100 MB, which a process that waits for the night need not hold.
    from fleet.jobs.diagnosis_job import diagnose_changed

    found = diagnose_changed(engine, settings.numbers, time.time(), workers, dask)
    _say(f"diagnosis: of {len(found)} rigs whose twins disagree")
    for rig, finding in found:
        _say(f"diagnosis: {rig}: {finding.text}")


def _say(text: str) -> None:
    print(text, flush=True)
