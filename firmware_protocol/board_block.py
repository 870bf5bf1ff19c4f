"""The configuration of a board: pins, parts and limits in one block of its EEPROM; `c/gh_config.c` reads it.

The block is 144 bytes: CRC-16 (as of frames) over all that follows, layout, microcontroller, limits, outputs,
up to eight sensor parts. Numbers are little-endian. Both sides hold a block to the same rules. A board whose
block is blank, damaged or against a rule drives nothing and reads nothing.
"""

import struct
from dataclasses import dataclass, field
from enum import IntEnum

from firmware_protocol.frame import crc16

BLOCK_SIZE = 144
PART_BYTES = 16  # of the block in one message
LAYOUT = 1
PARTS_MAX = 8
NO_PIN = 0xFF
_HEAD = struct.Struct("<BBQHhHHHB5BHBB")
_PART = struct.Struct("<BBBBhh6s")


class BoardKind(IntEnum):
    """Microcontroller that a block is for."""

    MEGA2560 = 1
    UNO = 2  # ATmega328P: Uno and Nano


class Part(IntEnum):
    """Sensor part, with the driver `c/drivers/gh_<name>.c`."""

    SHT3X = 1
    SHT4X = 2
    DHT22 = 3
    DS18B20 = 4
    SCD4X = 5
    BH1750 = 6
    SOIL = 7
    HCSR04 = 8
    FLOAT = 9


class Output(IntEnum):
    """Place of an output in the block, and the bit of its inversion."""

    HEATER = 0
    FAN = 1
    VALVE = 2
    CUTOFF = 3
    LED = 4


@dataclass(frozen=True, slots=True)
class BoardPins:
    """Arduino numbers of the pins by use. led : with a hardware PWM that nothing else needs"""

    digital: frozenset[int]
    listen: frozenset[int]  # with an interrupt on a change of level
    analog: frozenset[int]
    led: frozenset[int]


PINS = {
    # Without 0 and 1 (the host's line), 20 and 21 (I2C).
    BoardKind.MEGA2560: BoardPins(
        frozenset(range(2, 70)) - {20, 21},
        frozenset({10, 11, 12, 13, 50, 51, 52, 53, *range(62, 70)}),
        frozenset(range(54, 70)),
        frozenset({6, 7, 8}),
    ),
    # Without 0 and 1 (the host's line), A4 and A5 (I2C).
    BoardKind.UNO: BoardPins(
        frozenset(range(2, 18)), frozenset(range(2, 18)), frozenset(range(14, 18)), frozenset({3, 11})
    ),
}
I2C_ADDRESSES = {
    Part.SHT3X: (0x44, 0x45),
    Part.SHT4X: (0x44, 0x45, 0x46),
    Part.SCD4X: (0x62,),
    Part.BH1750: (0x23, 0x5C),
}
# Signals of a part inside; outside it measures the ambient temperature alone.
SIGNALS = {
    Part.SCD4X: "co2",
    Part.BH1750: "light",
    Part.SOIL: "soil_moisture",
    Part.HCSR04: "tank_level",
    Part.FLOAT: "tank_level",
}
MOST = {
    "temp_air": 2
}  # parts of one signal, else 1: two air sensors are compared, of more nobody knows what to do
TWO_PLACES = frozenset({Part.SHT3X, Part.SHT4X, Part.DHT22, Part.DS18B20})  # inside or outside the greenhouse


@dataclass(frozen=True, slots=True)
class PartConfig:
    """One sensor part. pin : Arduino number, or address on the I2C bus; second : echo pin of an HC-SR04

    first, last : counts of a dry and a wet soil probe; distances of an empty and a full tank [mm]
    first : full light [10 lux]; 1 for a float switch that is closed while there is water
    serial : the 48-bit serial number of a DS18B20, 0 for the only one on its wire
    """

    part: Part
    pin: int
    second: int = NO_PIN
    outside: bool = False
    first: int = 0
    last: int = 0
    serial: int = 0


@dataclass(frozen=True, slots=True)
class BoardBlock:
    """The configuration as values, in the units of the wire (milliseconds, 0.01 degC, 0.1 s).

    pins : by `Output`, NO_PIN where it is not wired; inverted : outputs that are on while their pin is low
    air_apart : difference of two air sensors above which they disagree [0.01 K]
    """

    kind: BoardKind
    board_id: int
    lease_max_ms: int = 10_000
    temp_trip: int = 4500
    valve_pulse_max_ds: int = 50
    pwm_window_ds: int = 200
    report_period_ms: int = 1000
    fan_safe_on: bool = True
    pins: tuple[int, int, int, int, int] = (NO_PIN,) * 5
    inverted: frozenset[Output] = frozenset()
    air_apart: int = 150
    parts: tuple[PartConfig, ...] = field(default=())


RANGES = {  # those of hello, in raw numbers
    "lease_max_ms": (100, 60_000),
    "temp_trip": (0, 10_000),
    "valve_pulse_max_ds": (0, 600),
    "pwm_window_ds": (10, 6000),
    "report_period_ms": (100, 60_000),
    "air_apart": (10, 1000),
    "board_id": (1, 2**64 - 1),
}


def encode_block(block: BoardBlock) -> bytes:
    """Return the bytes of the EEPROM. Errors: ValueError, which names the place and the rule"""
    problem = block_problem(block)
    if problem:
        raise ValueError(problem)
    flags = block.fan_safe_on | sum(2 << output for output in block.inverted)
    head = _HEAD.pack(
        LAYOUT, block.kind, block.board_id, block.lease_max_ms, block.temp_trip, block.valve_pulse_max_ds,
        block.pwm_window_ds, block.report_period_ms, flags, *block.pins, block.air_apart, len(block.parts), 0,
    )  # fmt: skip
    parts = b"".join(
        _PART.pack(
            one.part, one.outside, one.pin, one.second, one.first, one.last, one.serial.to_bytes(6, "little")
        )
        for one in block.parts
    )
    body = (head + parts).ljust(BLOCK_SIZE - 2, b"\0")
    return crc16(body).to_bytes(2, "little") + body


def decode_block(data: bytes) -> BoardBlock:
    """Return the configuration in a block. Errors: ValueError for a blank, damaged or forbidden one"""
    if len(data) != BLOCK_SIZE:
        raise ValueError(f"{len(data)} bytes, not {BLOCK_SIZE}")
    if data == b"\xff" * BLOCK_SIZE:
        raise ValueError("blank: the board has never been configured")
    if crc16(data[2:]) != int.from_bytes(data[:2], "little"):
        raise ValueError("damaged: the CRC does not match")
    layout, kind, board_id, lease, trip, valve, window, period, flags, *rest = _HEAD.unpack_from(data, 2)
    *pins, apart, count, reserved = rest
    if layout != LAYOUT or reserved or count > PARTS_MAX:
        raise ValueError(f"layout {layout} with {count} parts: not of this version")
    start = 2 + _HEAD.size
    rows = list(_PART.iter_unpack(data[start : start + PARTS_MAX * _PART.size]))
    # Bytes without a meaning are zero, so that two blocks that mean the same are the same.
    if any(data[start + count * _PART.size :]) or flags >= 64 or any(row[1] > 1 for row in rows):
        raise ValueError("bytes that mean nothing are not zero")
    parts = tuple(
        PartConfig(Part(part), pin, second, bool(outside), first, last, int.from_bytes(serial, "little"))
        for part, outside, pin, second, first, last, serial in rows[:count]
    )
    inverted = frozenset(output for output in Output if flags & 2 << output)
    block = BoardBlock(
        BoardKind(kind), board_id, lease, trip, valve, window, period, bool(flags & 1),
        (pins[0], pins[1], pins[2], pins[3], pins[4]), inverted, apart, parts,
    )  # fmt: skip
    problem = block_problem(block)
    if problem:
        raise ValueError(problem)
    return block


def block_problem(block: BoardBlock) -> str:
    """Return the first rule that a configuration breaks, with its place, "" if it keeps all."""
    for name, (low, high) in RANGES.items():
        if not low <= getattr(block, name) <= high:
            return f"{name}: {getattr(block, name)} is not within {low}..{high}"
    if len(block.parts) > PARTS_MAX:
        return f"sensors: {len(block.parts)} parts; the block has room for {PARTS_MAX}"
    pins = PINS[block.kind]
    used: dict[int, str] = {}
    for output in Output:
        pin, place = block.pins[output], output.name.lower()
        if pin == NO_PIN:
            continue
        allowed = pins.led if output is Output.LED else pins.digital
        problem = _take(used, pin, place, allowed)
        if problem:
            return problem
    for number, part in enumerate(block.parts):
        problem = _part_problem(part, f"sensors[{number}]", pins, used, block.parts[:number])
        if problem:
            return problem
    return ""


def _take(used: dict[int, str], pin: int, place: str, allowed: frozenset[int]) -> str:
    if pin not in allowed:
        return f"{place}: pin {pin} cannot serve there"
    if pin in used:
        return f"{place}: pin {pin} already serves as {used[pin]}"
    used[pin] = place
    return ""


def _part_problem(
    part: PartConfig, place: str, pins: BoardPins, used: dict[int, str], before: tuple[PartConfig, ...]
) -> str:
    """Return why a part cannot stand in the block, "" if it can, and note its pins as used."""
    if part.outside and part.part not in TWO_PLACES:
        return f"{place}: {part.part.name} measures inside only"
    if (part.serial != 0) > (part.part is Part.DS18B20):
        return f"{place}: {part.part.name} has no serial number"
    problem = _numbers_problem(part, place) or _signal_problem(part, place, before)
    if problem:
        return problem
    if part.part in I2C_ADDRESSES:
        return _address_problem(part, place, before)
    if part.part is Part.DS18B20:
        return _wire_problem(part, place, pins, used, before)
    if part.part is Part.HCSR04:
        return _take(used, part.pin, place, pins.digital) or _take(used, part.second, place, pins.listen)
    allowed = {Part.SOIL: pins.analog, Part.DHT22: pins.listen}.get(part.part, pins.digital)
    return _take(used, part.pin, place, allowed)


def _signal_problem(part: PartConfig, place: str, before: tuple[PartConfig, ...]) -> str:
    signal = signal_of(part)
    if sum(signal_of(one) == signal for one in before) >= MOST.get(signal, 1):
        return f"{place}: {signal} is measured by {MOST.get(signal, 1)} other part(s) already"
    return ""


def signal_of(part: PartConfig) -> str:
    """Return the signal that a part is there for; the humidity of an air sensor comes in addition."""
    return "temp_ambient" if part.outside else SIGNALS.get(part.part, "temp_air")


def _address_problem(part: PartConfig, place: str, before: tuple[PartConfig, ...]) -> str:
    if part.pin not in I2C_ADDRESSES[part.part]:
        return f"{place}: 0x{part.pin:02x} is not an address of {part.part.name}"
    if any(one.part in I2C_ADDRESSES and one.pin == part.pin for one in before):
        return f"{place}: address 0x{part.pin:02x} is used twice"
    return ""


def _wire_problem(
    part: PartConfig, place: str, pins: BoardPins, used: dict[int, str], before: tuple[PartConfig, ...]
) -> str:
    others = [one for one in before if one.part is Part.DS18B20]
    if any(one.pin != part.pin for one in others):
        return f"{place}: all DS18B20 hang on one pin"
    if others and (part.serial == 0 or any(one.serial in (0, part.serial) for one in others)):
        return f"{place}: several DS18B20 on a wire need serial numbers of their own"
    return "" if others else _take(used, part.pin, place, pins.digital)


def _numbers_problem(part: PartConfig, place: str) -> str:
    """Return why `first`, `last` and `second` do not suit the part, "" if they do."""
    if (part.second != NO_PIN) != (part.part is Part.HCSR04):
        return f"{place}: only an HC-SR04 has a second pin, its echo"
    first, last = part.first, part.last
    match part.part:
        case Part.SOIL:
            fits = 4 <= first <= 1019 and 4 <= last <= 1019 and abs(first - last) >= 20
        case Part.HCSR04:
            fits = 20 <= first <= 4000 and 20 <= last <= 4000 and first - last >= 10
        case Part.BH1750:
            fits = 1 <= first <= 5461 and last == 0  # 65535 counts are 54 612 lux
        case Part.FLOAT:
            fits = first in (0, 1) and last == 0
        case _:
            fits = first == last == 0
    return "" if fits else f"{place}: {first} and {last} do not suit {part.part.name}"
