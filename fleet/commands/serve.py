"""`greenhouse fleet serve`: the page of all rigs and its API."""

import argparse

from fleet.page.server import serve_fleet
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C. Errors: ConfigError, DataError"""
    serve_fleet(settings)
    return 0
