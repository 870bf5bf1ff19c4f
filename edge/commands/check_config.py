"""`greenhouse check-config FILE`: is this configuration fit to run?"""

import argparse

from edge import config
from edge.models.configured import configured_model
from edge.reference import make_reference


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", help="edge.yaml")


def run(arguments: argparse.Namespace) -> int:
    """0 when the daemon would start with it; an error names the place otherwise."""
    settings = config.load(arguments.file)
    configured_model(settings.control)
    make_reference(settings.reference)
    print(f"{arguments.file} is good (settings {config.config_hash(settings)})")
    return 0
