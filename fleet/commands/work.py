"""`greenhouse fleet work`: the jobs of a night, once."""

import argparse
import time

from edge.core.errors import DataError
from edge.core.sweep import add_arguments as add_sweep_arguments
from fleet.database.base import open_database
from fleet.jobs.diagnosis_job import diagnose_changed
from fleet.jobs.prior_job import renew_prior
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add where the jobs run."""
    add_sweep_arguments(parser, workers=1)


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Do the jobs and say what came of each. Errors: DataError, SweepError"""
    engine, utc = open_database(settings.database), time.time()
    found = diagnose_changed(engine, settings.numbers, utc, arguments.workers, arguments.dask)
    print(f"diagnosis: of {len(found)} rigs whose twins disagree")
    for rig, finding in found:
        print(f"diagnosis: {rig}: {finding.text}")
    try:
        done = renew_prior(engine, utc)
    except DataError as error:
        print(f"prior: {error}")
        return 0
    print(f"prior: of {done.boxes} boxes; {done.departures} values are far from their kind's")
    for rig, reason in done.unread.items():
        print(f"prior: the twin of {rig} is left out: {reason}")
    return 0
