"""`greenhouse run`: the daemon, as the systemd service starts it."""

import argparse
from pathlib import Path

from edge.app.daemon import Daemon
from edge.app.display import LineDisplay
from edge.app.outlet import standard_output
from edge.app.systemd import Notifier
from edge.config import loading as config
from edge.core.clock import RealClock
from edge.core.messages import TickRecord


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--config",
        type=Path,
        default=Path("/etc/greenhouse/edge.yaml"),
        help="the rig's configuration file; default: %(default)s",
    )


class _Report:
    """Reports every tick to systemd."""

    def __init__(self) -> None:
        self.notifier = Notifier.from_environment()
        self._ready = False

    def tick(self, record: TickRecord) -> None:
        """Show a record. Only the loop calls this, at the end of a whole tick."""
        status = f"tick {record.seq}, {record.decision.controller}, mode {record.mode}"
        if not self._ready:
            self.notifier.ready(status, record.step_s)
            self._ready = True
        self.notifier.alive(status)


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGTERM or Ctrl-C; one line per tick on standard output."""
    settings = config.load(arguments.config)
    report = _Report()
    with (
        standard_output() as out,
        Daemon(
            settings,
            RealClock(),
            after_tick=report.tick,
            config_file=arguments.config,
            more_sinks=(LineDisplay(out),),
        ) as daemon,
    ):
        daemon.run()
        report.notifier.stopping()
    report.notifier.close()
    return 0
