"""A whole set of simulated sensors on the pins of a simulated microcontroller.

The parts are those that the drivers are tested against, on the bus of a test; here each level of each pin is
timed by the board's own instructions.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

from avr.simulated_avr import FREQUENCY, MEGA2560, UNO, SimulatedAvr
from drivers.library import HIGH, LOW, OneWirePart
from test_i2c_drivers import Bh1750, BusClock, I2cPart, Scd4x, Sht
from test_one_wire import Ds18b20, rom_id
from test_pulse_drivers import PIN, TRIGGER, Dht22, Hcsr04

from firmware_protocol.board_block import BoardBlock, BoardKind, Part, PartConfig, encode_block

CYCLES_PER_US = FREQUENCY // 1_000_000
PRESENCE_US = (30.0, 150.0)  # after the reset pulse
PULLED_US = 1.0  # after the board let go; simavr's own pull-up comes a few cycles after that too
HELD_US = 30.0  # a part that sends a 0 keeps the line low for so long
DRY, WET, NOW = 620, 280, 450  # counts of the soil probe
BLOCK_AT = 16  # in the EEPROM


@dataclass(frozen=True)
class SensorWiring:
    """Pins of one board: the number in board.yaml, and port letter with bit."""

    kind: BoardKind
    microcontroller: str
    outputs: tuple[int, int, int, int, int]
    output_places: tuple[tuple[str, int], ...]  # of the first four
    wire: tuple[int, str, int]
    dht22: tuple[int, str, int]
    trigger: tuple[int, str, int]
    echo: tuple[int, str, int]
    sda: tuple[int, str, int]
    scl: tuple[int, str, int]
    soil: int
    channel: int


WIRINGS = {
    "mega2560": SensorWiring(
        BoardKind.MEGA2560, MEGA2560, (22, 23, 24, 25, 6), (("A", 0), ("A", 1), ("A", 2), ("A", 3)),
        (30, "C", 7), (10, "B", 4), (31, "C", 6), (11, "B", 5), (20, "D", 1), (21, "D", 0), 54, 0,
    ),
    "uno": SensorWiring(
        BoardKind.UNO, UNO, (7, 8, 9, 10, 11), (("D", 7), ("B", 0), ("B", 1), ("B", 2)),
        (2, "D", 2), (3, "D", 3), (4, "D", 4), (5, "D", 5), (18, "C", 4), (19, "C", 5), 14, 0,
    ),
}  # fmt: skip


def planned(levels: Iterable[tuple[float, int]], port: str, bit: int) -> bytes:
    """Return levels to come as avr_host.c takes them. levels : pairs of delay [us] and level"""
    return b"".join(
        struct.pack("<IBBB", max(1, round(delay * CYCLES_PER_US)), ord(port), bit, level)
        for delay, level in levels
    )


@dataclass
class WireLine:
    """1-Wire parts behind the levels of a pin. wrong : pulses that the datasheet does not allow"""

    parts: list[OneWirePart]
    is_stuck: bool = False
    low_us: float | None = None
    wrong: list[float] = field(default_factory=list)

    def change(self, level: int, now_us: float) -> list[tuple[float, int]]:
        """Take what the board does. Returns : levels to come"""
        if level == LOW:
            self.low_us = now_us
            return []
        if self.low_us is None or self.is_stuck:
            return []
        length, self.low_us = now_us - self.low_us, None
        if length >= 480.0:
            present = any([part.reset(now_us) for part in self.parts])
            return [(PRESENCE_US[0], 0), (PRESENCE_US[1], 1)] if present else []
        if not (1.0 <= length <= 15.0 or 60.0 <= length <= 120.0):
            self.wrong.append(length)
        is_one = length <= 15.0 and all([part.level(now_us) for part in self.parts])
        for part in self.parts:
            part.see(is_one, now_us)
        return [(PULLED_US, 0), (HELD_US, 1)] if length <= 15.0 and not is_one else []


class SensorParts:
    """SHT4x, SCD4x, BH1750, DHT22, two DS18B20 (inside and outside), soil probe and HC-SR04, all wired."""

    def __init__(self, wiring: SensorWiring) -> None:
        self.wiring = wiring
        self.clock = BusClock()
        self.sht, self.co2, self.light = Sht(self.clock, 1), Scd4x(self.clock), Bh1750(self.clock)
        self.i2c: dict[int, I2cPart] = {0x44: self.sht, 0x62: self.co2, 0x23: self.light}
        self.inside, self.outside = Ds18b20(rom_id(1), 25 * 16), Ds18b20(rom_id(2), 18 * 16)
        self.wire = WireLine([self.inside, self.outside])
        self.dht22, self.tank = Dht22(500, 251), Hcsr04(celsius=25.0)
        self.trigger_us = 0.0
        self.clocks_until_free: int | None = None  # a part holds SDA low for so many more clocks

    def level_changed(self, cycle: int, port: str, bit: int, level: int) -> bytes:
        """Take what the board does to a pin; return the levels to come."""
        now_us, wiring = cycle / CYCLES_PER_US, self.wiring
        place = (port, bit)
        if place == wiring.wire[1:]:
            return planned(self.wire.change(level, now_us), *place)
        if place == wiring.dht22[1:]:
            return self._call_dht22(level, now_us)
        if place == wiring.trigger[1:]:
            return self._trigger(level, now_us)
        if place == wiring.scl[1:] and self.clocks_until_free is not None:
            return self._clock(level)
        return b""

    def i2c_called(self, cycle: int, address: int, reading: bool) -> bytes | None:
        """Return what a part sends, b"" for one that listens, None where nobody acknowledges."""
        self.clock.us = self.clock.end_us = cycle / CYCLES_PER_US
        part = self.i2c.get(address)
        if part is None or not part.plugged or self.clock.us < part.busy_us:
            return None
        return part.exchange(b"", None) if reading else b""

    def i2c_written(self, cycle: int, address: int, data: bytes) -> None:
        """Take a transfer that has ended."""
        self.clock.us = self.clock.end_us = cycle / CYCLES_PER_US
        if data:
            self.i2c[address].exchange(data, 0)

    def _call_dht22(self, level: int, now_us: float) -> bytes:
        before = len(self.dht22.called_us)
        self.dht22.driven(PIN, level, now_us)
        if len(self.dht22.called_us) == before:
            return b""
        edges = [edge for begin, end in self.dht22.planned for edge in ((begin, 1), (end, 0))]
        levels = [(edge_us - now_us, level) for edge_us, level in edges]
        return planned([*levels, (levels[-1][0] + 50.0, 1)], *self.wiring.dht22[1:])

    def _trigger(self, level: int, now_us: float) -> bytes:
        if level == HIGH:
            self.trigger_us = now_us
        if level != LOW or not self.trigger_us:
            return b""
        shots = len(self.tank.shots_us)
        length_us, self.trigger_us = int(now_us - self.trigger_us), 0.0
        self.tank.pulsed(TRIGGER, length_us, now_us)
        if len(self.tank.shots_us) == shots:
            return b""
        [(start, end)] = self.tank.planned
        return planned([(start - now_us, 1), (end - now_us, 0)], *self.wiring.echo[1:])

    def _clock(self, level: int) -> bytes:
        assert self.clocks_until_free is not None
        self.clocks_until_free -= level == LOW
        if self.clocks_until_free > 0:
            return planned([(0.0, 0)], *self.wiring.sda[1:])
        self.clocks_until_free = None
        return planned([(0.0, 1)], *self.wiring.sda[1:])


def all_parts(wiring: SensorWiring) -> tuple[PartConfig, ...]:
    """Return every part but the DHT22, which would be a third for the air."""
    return (
        PartConfig(Part.SHT4X, 0x44),
        PartConfig(Part.DS18B20, wiring.wire[0], serial=1),
        PartConfig(Part.DS18B20, wiring.wire[0], outside=True, serial=2),
        PartConfig(Part.SCD4X, 0x62),
        PartConfig(Part.BH1750, 0x23, first=4000),
        PartConfig(Part.SOIL, wiring.soil, first=DRY, last=WET),
        PartConfig(Part.HCSR04, wiring.trigger[0], wiring.echo[0], first=400, last=100),
    )


def configured(wiring: SensorWiring, parts: tuple[PartConfig, ...], **values) -> bytes:
    """Return the EEPROM of a board with these parts and all its outputs."""
    block = BoardBlock(wiring.kind, 7, pins=wiring.outputs, parts=parts, **values)
    return b"\xff" * BLOCK_AT + encode_block(block)


def wire_up(avr: SimulatedAvr, wiring: SensorWiring) -> None:
    """Connect the parts."""
    pins: dict[str, int] = {}
    for _, port, bit in (wiring.wire, wiring.dht22, wiring.trigger, wiring.echo, wiring.sda, wiring.scl):
        pins[port] = pins.get(port, 0) | 1 << bit
    avr.watch(pins)
    avr.connect_i2c()
    avr.set_level(*wiring.echo[1:], 0)
    avr.set_millivolts(wiring.channel, round((NOW + 0.5) * 5000 / 1024))
