"""`greenhouse fleet changes`: which boxes changed, and what is missing in each."""

import argparse
import time
from datetime import datetime

from sqlalchemy.orm import Session

from fleet.database.base import open_database
from fleet.jobs.changes import changes
from fleet.settings import FleetSettings

DAY_S = 86400.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add how far back it looks."""
    parser.add_argument("--days", type=float, default=7.0, help="how far back (usual: 7)")


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Print a paragraph for each rig that changed. Errors: DataError"""
    with Session(open_database(settings.database)) as session:
        found = changes(session, time.time() - DAY_S * arguments.days)
    for rig, lines in found.items():
        print(rig)
        for utc, text in lines:
            print(f"  {datetime.fromtimestamp(utc):%Y-%m-%d %H:%M}  {text}")
    if not found:
        print(f"no box has changed in {arguments.days:g} days")
    return 0
