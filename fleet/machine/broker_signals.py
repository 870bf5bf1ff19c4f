"""A word to the running broker: read the access list anew."""

import os
import signal
import time
from pathlib import Path

from fleet.machine.places import FleetMachine

SETTLE_S = 0.5  # it looks for signals ten times a second


def reload_rights(machine: FleetMachine) -> bool:
    """Have the broker read its access list; return whether one runs. Errors: PermissionError"""
    try:
        number = int((Path(machine.data) / "broker" / "mosquitto.pid").read_text())
        if (Path("/proc") / str(number) / "comm").read_text().strip() != "mosquitto":
            return False  # it has ended, and the number is somebody else's
        os.kill(number, signal.SIGHUP)
        # mosquitto 2.0 forgets a signal that comes while it reads: that of another rig's a moment before.
        time.sleep(SETTLE_S)
        os.kill(number, signal.SIGHUP)
    except (FileNotFoundError, ProcessLookupError, ValueError):
        return False
    return True
