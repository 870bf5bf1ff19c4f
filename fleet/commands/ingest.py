"""`greenhouse fleet ingest`: the service between the broker and the stores."""

import argparse
import signal
import sys
import threading
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from fleet.database.base import DatabaseAway, open_database
from fleet.ingest.loop import RETRY_MAX_S, Ingest
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the journal, by which it is measured."""
    parser.add_argument("--journal", type=Path, help="append a JSON line of times for each batch")


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Run until SIGTERM or SIGINT; wait for a database that is away. Errors: ConfigError, DataError"""
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    while not ended.is_set():
        try:
            service = Ingest(settings, open_database(settings.database), arguments.journal)
        except (DatabaseAway, SQLAlchemyError) as error:
            print(f"ingest: {error}; again in {RETRY_MAX_S:g} s", file=sys.stderr, flush=True)
            ended.wait(RETRY_MAX_S)
        else:
            service.run(ended)
            break
    return 0
