"""`greenhouse run`: the daemon, as the systemd service starts it."""

import argparse
import os
from pathlib import Path
from typing import Any

from edge.app.commission_button import CommissionDesk
from edge.app.daemon import REQUESTS_VARIABLE, Daemon
from edge.app.display import LineDisplay
from edge.app.nightly_diagnosis import BackgroundProcess
from edge.app.outlet import standard_output
from edge.app.systemd import Notifier
from edge.commands.arguments import add_config
from edge.config import loading as config
from edge.core.clock import RealClock
from edge.core.messages import TickRecord
from edge.formats.owner import become_owner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_config(parser)


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
    settings, clock, report = config.load(arguments.config), RealClock(), _Report()
    become_owner(settings.state_file)  # where root starts it by hand
    folder = os.environ.get(REQUESTS_VARIABLE)
    desk = CommissionDesk(settings, arguments.config, BackgroundProcess(Path(folder) if folder else None))
    with standard_output() as out:
        shared: dict[str, Any] = {"config_file": arguments.config, "more_sinks": (LineDisplay(out),)}
        while True:
            with Daemon(settings, clock, report.tick, commissioning=desk, **shared) as daemon:
                daemon.run()
                if not desk.is_due:
                    report.notifier.stopping()
            if not desk.is_due:
                break
            desk.make_tests(clock, report.tick, **shared)
            if desk.is_over:
                break
    desk.close()
    report.notifier.close()
    return 0
