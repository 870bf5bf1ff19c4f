"""`greenhouse fleet ingest`: the service between the broker and the stores."""

import argparse
import signal
import threading
from pathlib import Path

from fleet.database.base import open_database
from fleet.ingest.loop import Ingest
from fleet.settings import FleetSettings


def add_ingest_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the journal, by which it is measured."""
    parser.add_argument("--journal", type=Path, help="append a JSON line of times for each batch")


def run_ingest(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Run until SIGTERM or SIGINT; a database that goes away meanwhile is waited for.

    Errors : ConfigError; DataError for a database that cannot be opened at the start
    """
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    # A wrong setting is told by the end; of a database that is only away, systemd starts this one again.
    Ingest(settings, open_database(settings.database), arguments.journal).run(ended)
    return 0
