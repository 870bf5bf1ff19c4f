"""board.yaml: pins, sensor parts and limits as a person writes them, made into the block of the EEPROM."""

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

from edge.core.errors import DataError
from edge.core.plain_text import quote
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.reader import DocumentError, read_yaml
from firmware_protocol.board_block import (
    I2C_ADDRESSES,
    NO_PIN,
    PINS,
    BoardBlock,
    BoardKind,
    Output,
    Part,
    PartConfig,
    block_problem,
)

BOARDS = {"mega2560": BoardKind.MEGA2560, "uno": BoardKind.UNO}
ID_MAX = 2**63 - 1
EXAMPLE_ID = 1  # of deploy/board.example.yaml, not of a board
LUX_STEP = 10.0  # of full light in the block
KEYS = {  # keys that a part must have; those of a part's own and no others may stand beside part and place
    Part.SHT3X: ("address",),
    Part.SHT4X: ("address",),
    Part.SCD4X: (),
    Part.BH1750: ("address", "full_lux"),
    Part.DHT22: ("pin",),
    Part.DS18B20: ("pin",),
    Part.SOIL: ("pin", "dry", "wet"),
    Part.HCSR04: ("pin", "echo", "empty_mm", "full_mm"),
    Part.FLOAT: ("pin",),
}
MAY_HAVE = {Part.DS18B20: ("serial",), Part.FLOAT: ("closed_while_water",)}
Count = Annotated[int, Rule(low=0, high=1023)]
Millimetres = Annotated[int, Rule(low=20, high=4000, unit="mm")]
Pin = Annotated[str, Rule(pattern=r"[DA]\d{1,2}", most=3)]


@dataclass(frozen=True, slots=True)
class OutputDocument:
    """A relay's or transistor's pin. active_low : the output is on while the pin is low"""

    pin: Pin
    active_low: bool = False


@dataclass(frozen=True, slots=True)
class OutputsDocument:
    """The outputs that are wired; `cutoff` is the second relay in the heater's supply."""

    heater: OutputDocument | None = None
    fan: OutputDocument | None = None
    valve: OutputDocument | None = None
    cutoff: OutputDocument | None = None
    led: OutputDocument | None = None


@dataclass(frozen=True, slots=True)
class SensorDocument(CheckedDocument):
    """One sensor part. pin : of its data, of an HC-SR04 its trigger; serial : of a DS18B20, as
    Linux writes it, `28-0123456789ab`"""

    part: Annotated[str, Rule(choices=tuple(part.name.lower() for part in Part))]
    place: Annotated[str, Rule(choices=("inside", "outside"))] = "inside"
    pin: Pin | None = None
    echo: Pin | None = None
    address: Annotated[str, Rule(pattern="0x[0-7][0-9a-fA-F]", most=4)] | None = None
    serial: Annotated[str, Rule(pattern="28-[0-9a-f]{12}", most=15)] | None = None
    dry: Count | None = None
    wet: Count | None = None
    empty_mm: Millimetres | None = None
    full_mm: Millimetres | None = None
    full_lux: Annotated[float, Rule(low=LUX_STEP, high=54_610.0, unit="lux")] | None = None
    closed_while_water: bool | None = None

    @property
    def kind(self) -> Part:
        """Part of the block."""
        return Part[self.part.upper()]

    def cross_check(self) -> None:
        """Check that the part has its keys and no others."""
        known = {*KEYS[self.kind], *MAY_HAVE.get(self.kind, ()), "part", "place"}
        for key, value in asdict(self).items():
            if value is None and key in KEYS[self.kind]:
                self.refuse(key, f"missing: {self.part} needs {', '.join(KEYS[self.kind])}")
            if value is not None and key not in known:
                self.refuse(key, f"{self.part} has no such key; its keys: {', '.join(sorted(known))}")


@dataclass(frozen=True, slots=True)
class LimitsDocument:
    """The board's own limits, whatever the host asks for.

    lease_max_s : outputs end this long after the host's last word; air_sensors_apart_k : above, two disagree
    """

    lease_max_s: Annotated[float, Rule(low=0.1, high=60.0)] = 10.0
    temp_trip_c: Annotated[float, Rule(low=0.0, high=100.0)] = 45.0
    valve_pulse_max_s: Annotated[float, Rule(low=0.0, high=60.0)] = 5.0
    pwm_window_s: Annotated[float, Rule(low=1.0, high=600.0)] = 20.0
    report_period_s: Annotated[float, Rule(low=0.1, high=60.0)] = 1.0
    fan_safe_on: bool = True
    air_sensors_apart_k: Annotated[float, Rule(low=0.1, high=10.0)] = 1.5


@dataclass(frozen=True, slots=True)
class BoardDocument:
    """board.yaml as a whole."""

    board: Annotated[str, Rule(choices=tuple(BOARDS))]
    id: Annotated[int, Rule(low=1, high=ID_MAX)]
    outputs: OutputsDocument = field(default_factory=OutputsDocument)
    sensors: tuple[SensorDocument, ...] = ()
    limits: LimitsDocument = field(default_factory=LimitsDocument)


def read_board_file(path: Path) -> BoardBlock:
    """Return the block that a board.yaml describes. Errors: DataError, with file, place and rule"""
    document = read_yaml(BoardDocument, path)
    kind = BOARDS[document.board]
    try:
        block = _block(document, kind)
    except ValueError as error:
        raise DocumentError(str(path), [("", str(error))]) from None
    if problem := block_problem(block):
        raise DataError(f"{path}: {problem} ({document.board})")
    return block


def pin_name(pin: int, kind: BoardKind) -> str:
    """Return a pin's name as it is printed on the board, "-" for none."""
    if pin == NO_PIN:
        return "-"
    first_analog = min(PINS[kind].analog)
    return f"D{pin}" if pin < first_analog else f"A{pin - first_analog}"


def _block(document: BoardDocument, kind: BoardKind) -> BoardBlock:
    limits, outputs = document.limits, document.outputs
    wired = [getattr(outputs, output.name.lower()) for output in Output]
    heater, fan, valve, cutoff, led = (NO_PIN if one is None else _pin(one.pin, kind) for one in wired)
    return BoardBlock(
        kind,
        document.id,
        lease_max_ms=round(limits.lease_max_s * 1000),
        temp_trip=round(limits.temp_trip_c * 100),
        valve_pulse_max_ds=round(limits.valve_pulse_max_s * 10),
        pwm_window_ds=round(limits.pwm_window_s * 10),
        report_period_ms=round(limits.report_period_s * 1000),
        fan_safe_on=limits.fan_safe_on,
        pins=(heater, fan, valve, cutoff, led),
        inverted=frozenset(
            output for output, one in zip(Output, wired, strict=True) if one is not None and one.active_low
        ),
        air_apart=round(limits.air_sensors_apart_k * 100),
        parts=tuple(_parts(document, kind)),
    )


def _parts(document: BoardDocument, kind: BoardKind) -> Iterator[PartConfig]:
    for one in document.sensors:
        first, last = _numbers(one)
        part = one.kind
        if part in I2C_ADDRESSES:
            pin = I2C_ADDRESSES[part][0] if one.address is None else int(one.address, 16)
        else:
            pin = _pin(one.pin or "", kind)
        yield PartConfig(
            part,
            pin,
            second=NO_PIN if one.echo is None else _pin(one.echo, kind),
            outside=one.place == "outside",
            first=first,
            last=last,
            serial=int(one.serial[3:], 16) if one.serial else 0,
        )


def _numbers(one: SensorDocument) -> tuple[int, int]:
    match one.kind:
        case Part.SOIL:
            return one.dry or 0, one.wet or 0
        case Part.HCSR04:
            return one.empty_mm or 0, one.full_mm or 0
        case Part.BH1750:
            return round((one.full_lux or 0.0) / LUX_STEP), 0
        case Part.FLOAT:
            return int(one.closed_while_water is not False), 0
        case _:
            return 0, 0


def _pin(name: str, kind: BoardKind) -> int:
    """Return the Arduino number of a pin. Errors: ValueError"""
    found = re.fullmatch(r"([DA])(\d{1,2})", name)
    if found is None:
        raise ValueError(f"{quote(name)} is not a pin such as D22 or A0")
    number = int(found[2])
    return number + min(PINS[kind].analog) if found[1] == "A" else number
