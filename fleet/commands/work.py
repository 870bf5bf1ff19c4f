"""`greenhouse fleet work`: the jobs of a night, once."""

import argparse
import time

from fleet.database.base import open_database
from fleet.jobs.prior_job import renew_prior
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Do the jobs and say what came of each. Errors: DataError"""
    engine = open_database(settings.database)
    done = renew_prior(engine, time.time())
    print(f"prior: of {done.boxes} boxes; {done.departures} values are far from their kind's")
    for rig, reason in done.unread.items():
        print(f"prior: the twin of {rig} is left out: {reason}")
    return 0
