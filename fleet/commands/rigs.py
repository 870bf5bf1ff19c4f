"""`greenhouse fleet rigs`: the rigs that were ever heard."""

import argparse
import time

from sqlalchemy import select
from sqlalchemy.orm import Session

from fleet.database.base import open_database
from fleet.database.rigs import FleetRig
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
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
