"""`greenhouse restore FILE`: puts everything of a backup in its place; the daemon must not run."""

import argparse
from pathlib import Path

from edge.app.backup import restore
from edge.commands.arguments import add_config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the backup")
    add_config(parser)
    parser.add_argument(
        "--replace", action="store_true", help="keep what is there under another name, beside the restored"
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when everything is in its place. Errors: DataError, ConfigError, RequestError"""
    for line in restore(arguments.file, arguments.config, arguments.replace):
        print(line)
    print("restored; `greenhouse check-config` looks at it, `systemctl start greenhouse` begins")
    return 0
