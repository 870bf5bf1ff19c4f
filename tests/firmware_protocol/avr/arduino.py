"""An Arduino on a serial port: Debian's bootloader for it on a microcontroller in simavr."""

import select
import threading
import time
from pathlib import Path
from types import TracebackType

from avr.sensor_parts import SensorParts, SensorWiring, wire_up
from avr.simulated_avr import AvrEvent, SimulatedAvr, transmitted

from firmware_protocol.virtual_board.port import PseudoTerminal

FOLDER = Path("/usr/share/arduino/hardware/arduino/avr/bootloaders")
BOOTLOADERS = {
    "uno": FOLDER / "optiboot" / "optiboot_atmega328.hex",
    "mega2560": FOLDER / "stk500v2" / "stk500boot_v2_mega2560.hex",
}
# An opened port pulls DTR, which resets the microcontroller through a capacitor, and avrdude waits before it
# speaks. A pseudo-terminal has no DTR: the first byte of an opening comes this long after the reset.
BOOT_MS = 450
POLL_S = 0.002
BUSY_MS, BYTE_MS = 5.0, 0.0868  # the bootloader erases and writes a page; a byte at 115200 baud
BLANK = ":10000000" + "FF" * 16 + "00\n"


class Arduino:
    """A board with its power on. cut_after : bytes of the host after which the cable is pulled"""

    def __init__(
        self,
        avr_host: Path,
        board: str,
        wiring: SensorWiring,
        link: Path,
        program: Path,
        eeprom: bytes = b"\xff",
    ) -> None:
        self._avr = SimulatedAvr(
            avr_host, program, eeprom, wiring.microcontroller, SensorParts(wiring), BOOTLOADERS[board]
        )
        wire_up(self._avr, wiring)
        self._port = PseudoTerminal(link)
        self._port.plug()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.cut_after: int | None = None
        self.events: list[AvrEvent] = []
        self.eeprom = eeprom  # as the last power failure has left it

    def __enter__(self) -> "Arduino":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """The power fails."""
        self._stop.set()
        self._thread.join()
        self.eeprom = self._avr.eeprom()
        self._port.unplug()
        self._avr.__exit__()

    def _run(self) -> None:
        """In real time while the line is idle, as fast as it goes while it is not."""
        reached_s = time.monotonic()
        while not self._stop.is_set():
            select.select([self._port], [], [], POLL_S)
            data = self._take_bytes()
            idle_ms = (time.monotonic() - reached_s) * 1000
            trace = self._avr.run(BUSY_MS + len(data) * BYTE_MS if data else idle_ms, data)
            reached_s = time.monotonic()
            self.events += [event for event in trace if event.kind != "T"]
            out = transmitted(trace)
            if out:
                self._port.write(out)

    def _take_bytes(self) -> bytes:
        user = self._port.user
        data = self._port.read()
        if user is not None and self._port.user is None:  # the host has closed it
            return b""
        if data and self._port.user is None:
            self._port.user = self
            self._avr.reset()
            self.events += self._avr.run(BOOT_MS)
        if self.cut_after is not None:
            data = data[: self.cut_after]
            self.cut_after -= len(data)
            if self.cut_after == 0:
                self.cut_after = None
                self._port.plug()
        return data
