"""`greenhouse restore FILE`: puts everything of a backup in its place; the daemon must not run."""

import argparse
import sys
from pathlib import Path

from edge.app.backup import restore
from edge.commands.arguments import add_config
from edge.core.errors import DataError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the backup")
    add_config(parser)
    parser.add_argument(
        "--replace", action="store_true", help="keep what is there under another name, next to the restored"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask before anything is written")


def run(arguments: argparse.Namespace) -> int:
    """0 when everything is in its place. Errors: DataError, ConfigError, RequestError"""
    agrees = (lambda places: True) if arguments.yes else ask
    try:
        for line in restore(arguments.file, arguments.config, arguments.replace, agrees):
            print(line)
    except OSError as error:
        raise DataError(f"{error.filename}: {error.strerror}; what is printed above is restored") from error
    print("restored; `greenhouse check-config` looks at it, `systemctl start greenhouse` begins")
    return 0


def ask(places: list[str]) -> bool:
    """Show what would be written, and return whether the person at the terminal wants it."""
    print("This would be written:", *places, sep="\n  ")
    if not sys.stdin.isatty():
        print("there is no terminal to confirm at: --yes restores without a question", file=sys.stderr)
        return False
    return input("Write it? [y/N] ").strip().lower() in ("y", "yes")
