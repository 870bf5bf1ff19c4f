"""`greenhouse fleet rigs`, `changes` and `rules`: what is known, printed."""

import argparse
import time
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.commands.arguments import number
from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.jobs.changes import changes
from fleet.machine.alarm_rules import alarm_rules
from fleet.settings import FleetSettings

DAY_S = 86400.0


def add_changes_arguments(parser: argparse.ArgumentParser) -> None:
    """Add how far back it looks."""
    parser.add_argument("--days", type=number(0.0, 36500.0), default=7.0, help="how far back (usual: 7)")


def run_changes(settings: FleetSettings, arguments: argparse.Namespace) -> int:
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


def run_rigs(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Print a line for each rig. Errors: DataError"""
    now = time.time()
    with Session(open_database(settings.database)) as session:
        for rig in session.scalars(select(FleetRig).order_by(FleetRig.name)):
            air = rig.state.get("temp_air_c")
            shown = "no air temperature" if air is None else f"{air:.1f} °C"
            print(
                f"{rig.name:<24} {'online' if rig.is_there(now) else 'away':<8} {rig.kind or '-':<16} {shown}"
            )
    return 0


def run_rules(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Print them."""
    print(alarm_rules(settings.alarms), end="")
    return 0
