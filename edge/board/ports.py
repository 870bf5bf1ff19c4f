"""Serial ports of this computer on which a board may be, and the names of them that last."""

import re
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from edge.config.settings import BoardSettings

USUAL = re.compile(r"/dev/tty(ACM|USB)\d+")  # USB adapters; ttyS and ttyAMA exist without a board
BY_ID = Path("/dev/serial/by-id")  # udev's links by maker and serial number


@dataclass(frozen=True, slots=True)
class FoundPort:
    """A serial port. text : what the system knows of it, for a person"""

    path: str
    text: str


def find_ports() -> list[FoundPort]:
    """Return the USB serial ports, sorted. No port is opened, because that restarts an Arduino."""
    ports = [port for port in list_ports.comports() if USUAL.fullmatch(port.device)]
    return sorted((FoundPort(p.device, p.description) for p in ports), key=lambda port: port.path)


def lasting_name(path: str) -> str:
    """Return a name of the port that stays when boards are plugged in another order; else `path`."""
    device = Path(path).resolve()
    links = [Path(BoardSettings().port), *(sorted(BY_ID.iterdir()) if BY_ID.is_dir() else [])]
    return next((str(link) for link in links if link.exists() and link.resolve() == device), path)
