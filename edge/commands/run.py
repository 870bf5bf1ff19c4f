"""`greenhouse run`: the daemon, as the systemd service starts it."""

import argparse
import sys
from pathlib import Path

from edge import config
from edge.clock import RealClock
from edge.daemon import Daemon
from edge.display import tick_line
from edge.messages import TickRecord
from edge.systemd import Notifier


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--config", type=Path, default=Path("/etc/greenhouse/edge.yaml"))


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGTERM or Ctrl-C; one line per tick on standard output."""
    settings = config.load(arguments.config)
    notifier = Notifier.from_environment()

    def after_tick(record: TickRecord) -> None:
        print(tick_line(record), flush=True)
        status = f"tick {record.seq}, {record.decision.controller}, mode {record.mode}"
        if after_tick.first:  # type: ignore[attr-defined]
            notifier.ready(status)
            after_tick.first = False  # type: ignore[attr-defined]
        notifier.alive(status)

    after_tick.first = True  # type: ignore[attr-defined]
    with Daemon(settings, RealClock(), after_tick=after_tick) as daemon:
        daemon.run()
    notifier.stopping()
    notifier.close()
    sys.stdout.flush()
    return 0
