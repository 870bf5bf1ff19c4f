"""`greenhouse fleet rules`: the rules of vmalert, for an engine that runs elsewhere."""

import argparse

from fleet.machine.alarm_rules import alarm_rules
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Print them."""
    print(alarm_rules(settings.alarms), end="")
    return 0
