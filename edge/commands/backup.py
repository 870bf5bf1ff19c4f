"""`greenhouse backup --out FILE`: configuration, secrets, state, history and bundles of a rig in one file."""

import argparse
from pathlib import Path

from edge.app.backup import back_up
from edge.commands.arguments import add_config, writing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_config(parser)
    parser.add_argument("--out", type=Path, required=True, help="file to write, readable by its owner alone")


def run(arguments: argparse.Namespace) -> int:
    """0 when the backup is written. Errors: ConfigError, DataError, RequestError"""
    with writing(arguments.out):
        sizes = back_up(arguments.config, arguments.out)
    for name, size in sizes.items():
        print(f"{name:12s} {size / 1e6:9.3f} MB")
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.3f} MB; it holds secrets")
    return 0
