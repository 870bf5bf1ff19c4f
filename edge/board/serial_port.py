"""An open serial port that counts its bytes, so that a simulated board can run in lock-step with it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial
from serial.tools import list_ports

from edge.config.settings import BoardSettings


class PortGone(Exception):
    """The port was unplugged, or never there; the text says what the system said."""


class WirePort(Protocol):
    """An open port; `edge.core.clock.Port` is what a clock needs of it."""

    bytes_in: int
    bytes_out: int

    def fileno(self) -> int:
        """Return the descriptor that a clock waits on."""
        ...

    def read(self) -> bytes:
        """Return the bytes that have arrived, maybe none; never wait. Errors: PortGone."""
        ...

    def write(self, data: bytes) -> None:
        """Hand over `data` and add its length to `bytes_out`. Errors: PortGone."""
        ...

    def close(self) -> None:
        """Release the port, also an unplugged one; never raises."""
        ...


OpenPort = Callable[[str, int], WirePort]  # path, baudrate; raises PortGone


class SerialPort:
    """pyserial without waiting: reads give what is there, writes hand over to the kernel's buffer."""

    def __init__(self, path: str, baudrate: int) -> None:
        """Open `path`. Errors: PortGone."""
        self.path = path
        self.bytes_in = 0
        self.bytes_out = 0
        try:
            # exclusive: two daemons on one line would each believe the other's acknowledgements.
            self._serial = serial.Serial(path, baudrate, timeout=0, write_timeout=0.5, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise PortGone(str(error)) from error

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return int(self._serial.fileno())

    def read(self) -> bytes:
        """All bytes that have arrived, maybe none. Errors: PortGone."""
        try:
            data = bytes(self._serial.read(4096))
        except (OSError, TypeError) as error:  # TypeError: pyserial's answer to a port closed meanwhile
            raise PortGone(str(error)) from error
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Hand `data` to the kernel. Errors: PortGone, also when the line takes nothing for 0.5 s."""
        try:
            self._serial.write(data)
        except OSError as error:
            raise PortGone(str(error)) from error
        self.bytes_out += len(data)

    def close(self) -> None:
        """Give the port back; a port that is gone is closed already."""
        try:
            self._serial.close()
        except OSError:
            return


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
