"""A board's real program in simavr, with simulated sensors, in place of the virtual board's core.

    python -m firmware_protocol.virtual_board --core avr.avr_core:uno ...

Box, faults, clock and socket are those of the virtual board. The environment's AVR_HOST names the simulator's
program; AVR_BLANK=1 is a board that was never configured, AVR_EEPROM a file with the content of its EEPROM.
"""

import atexit
import os
from collections.abc import Mapping
from pathlib import Path

from avr.sensor_parts import (
    DRY,
    WET,
    WIRINGS,
    SensorParts,
    SensorWiring,
    all_parts,
    configured,
    wire_up,
)
from avr.simulated_avr import SimulatedAvr, transmitted

import firmware_protocol
from firmware_protocol.messages import Quality, ResetCause
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.core import Pins
from firmware_protocol.virtual_board.device import Boot, Core

EEPROM_SIZE = 1024
FULL_COUNTS = 48_000.0  # of a BH1750 at the 40 000 lux of the configuration
EMPTY_MM, FULL_MM = 400.0, 100.0
SUPPLY_MV, ADC_STEPS = 5000.0, 1024.0
HEX = Path(firmware_protocol.__file__).parent / "hex"


class AvrCore:
    """The microcontroller behind the calls of `core.BoardCore`. Samples set what its sensors measure."""

    def __init__(self, host: Path, program: Path, wiring: SensorWiring, eeprom: bytes) -> None:
        self._parts = SensorParts(wiring)
        self._wiring = wiring
        self.avr = SimulatedAvr(host, program, eeprom, wiring.microcontroller, self._parts)
        wire_up(self.avr, wiring)
        self._waiting = b""
        self._sent = b""
        self._now_ms = 0

    def receive(self, data: bytes, now_ms: int) -> None:
        """Bytes from the line; they come in from the next step on."""
        self._waiting += data

    def step(self, now_ms: int) -> Pins:
        """Run to that time and return the outputs."""
        elapsed_ms = (now_ms - self._now_ms) % 2**32
        self._now_ms = now_ms
        if elapsed_ms:
            self._sent += transmitted(self.avr.run(elapsed_ms, self._waiting))
            self._waiting = b""
        heater, fan, valve, supply = (self._is_on(place) for place in self._wiring.output_places)
        return Pins(heater, fan, 0.0, valve, not supply)

    def _is_on(self, place: tuple[str, int]) -> bool:
        first = 0x20 + 3 * (ord(place[0]) - ord("A"))
        direction, output = self.avr.read(first + 1, 2)
        return bool(direction & output & 1 << place[1])

    def transmit(self) -> bytes:
        """Return the bytes for the line since the last call."""
        sent, self._sent = self._sent, b""
        return sent

    def persistent(self) -> bytes:
        """Return the latches in the EEPROM."""
        return self.avr.eeprom()[:4]

    def sample(self, samples: Mapping[str, tuple[float | None, int]], now_ms: int) -> None:
        """Let the parts measure this; one without a number is unplugged."""
        good = {
            name: value if quality == Quality.GOOD else None for name, (value, quality) in samples.items()
        }
        parts = self._parts
        air, humidity = good.get("temp_air_c"), good.get("rel_humidity_pct")
        _plug(parts.sht, air is not None)
        _plug(parts.inside, air is not None)
        if air is not None:
            parts.sht.words = _word((air + 45.0) / 175.0), _word(((humidity or 0.0) + 6.0) / 125.0)
            parts.inside.sixteenths = round(air * 16.0)
            parts.tank.speed = 331.3 + 0.606 * air
        self._sample_others(good)

    def _sample_others(self, good: Mapping[str, float | None]) -> None:
        parts = self._parts
        ambient, co2, light = good.get("temp_ambient_c"), good.get("co2_ppm"), good.get("light")
        soil, tank = good.get("soil_moisture"), good.get("tank_level")
        for part, value in ((parts.outside, ambient), (parts.co2, co2), (parts.light, light)):
            _plug(part, value is not None)
        parts.tank.plugged = tank is not None
        parts.outside.sixteenths = round((ambient or 0.0) * 16.0)
        parts.co2.words = round(co2 or 0.0), *parts.co2.words[1:]
        parts.light.counts = round((light or 0.0) * FULL_COUNTS)
        parts.tank.mm = EMPTY_MM + (FULL_MM - EMPTY_MM) * (tank or 0.0)
        counts = 0.0 if soil is None else DRY + (WET - DRY) * soil + 0.5
        self.avr.set_millivolts(self._wiring.channel, round(counts * SUPPLY_MV / ADC_STEPS))


def _word(share: float) -> int:
    return round(min(max(share, 0.0), 1.0) * 65535.0)


def _plug(part, is_plugged: bool) -> None:
    """Plug a part in or out, once."""
    if is_plugged and not part.plugged:
        part.plug()
    part.plugged = is_plugged


class AvrBoots:
    """Starts of one board; what its EEPROM holds but the latches is kept between them."""

    def __init__(self, host: Path, board: str, is_blank: bool) -> None:
        self._host, self._wiring = host, WIRINGS[board]
        self._program = next(HEX.glob(f"{board}-*.hex"))
        configuration = b"" if is_blank else configured(self._wiring, all_parts(self._wiring))
        if saved := os.environ.get("AVR_EEPROM"):
            configuration = Path(saved).read_bytes()
        self._eeprom = configuration.ljust(EEPROM_SIZE, b"\xff")
        self._core: AvrCore | None = None

    def boot(self, persistent: bytes, cause: ResetCause, boot_count: int) -> Core:
        """Start the program. The simulator knows no cause but the power's."""
        self.close()
        self._eeprom = persistent.ljust(4, b"\xff") + self._eeprom[4:]
        self._core = AvrCore(self._host, self._program, self._wiring, self._eeprom)
        return self._core

    def close(self) -> None:
        """The power fails."""
        if self._core is not None:
            self._eeprom = self._core.avr.eeprom()
            self._core.avr.__exit__()
            self._core = None


def _boot(board: str) -> Boot:
    boots = AvrBoots(Path(os.environ["AVR_HOST"]), board, os.environ.get("AVR_BLANK") == "1")
    atexit.register(boots.close)
    return boots.boot


def uno(_config: BoardConfig) -> Boot:
    """An Uno; its configuration stands in its EEPROM."""
    return _boot("uno")


def mega2560(_config: BoardConfig) -> Boot:
    """A Mega; its configuration stands in its EEPROM."""
    return _boot("mega2560")
