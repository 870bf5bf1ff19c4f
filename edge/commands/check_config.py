"""`greenhouse check-config FILE`: is this configuration fit to run?"""

import argparse

from edge import config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", help="edge.yaml")


def run(arguments: argparse.Namespace) -> int:
    """0 when the file is good; a ConfigError names the place otherwise."""
    settings = config.load(arguments.file)
    print(f"{arguments.file} is good (settings {config.config_hash(settings)})")
    return 0
