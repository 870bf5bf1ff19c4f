"""Wiring of a board: a row for each connection, as a table for the terminal and as a picture (SVG)."""

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

from edge.board.board_file import pin_name
from edge.formats.table import Table
from firmware_protocol.board_block import (
    I2C_ADDRESSES,
    NO_PIN,
    BoardBlock,
    BoardKind,
    Output,
    Part,
    PartConfig,
)

NAMES = {BoardKind.MEGA2560: "Arduino Mega (ATmega2560)", BoardKind.UNO: "Arduino Uno or Nano (ATmega328P)"}
I2C_PINS = {BoardKind.MEGA2560: ("D20 SDA", "D21 SCL"), BoardKind.UNO: ("A4 SDA", "A5 SCL")}
OUTPUTS = {
    Output.HEATER: ("heater relay", "a thermal cut-out stands in the heater's supply"),
    Output.FAN: ("fan relay", ""),
    Output.VALVE: ("valve relay", ""),
    Output.CUTOFF: (
        "cut-off relay",
        "in series with the heater relay",
    ),
    Output.LED: ("LED driver", "PWM input"),
}
LEVELS = "a 3.3 V part: a breakout with level shifter and pull-ups"
PARTS = {  # name, what to mind
    Part.SHT3X: ("SHT3x air sensor", LEVELS),
    Part.SHT4X: ("SHT4x air sensor", LEVELS),
    Part.DHT22: ("DHT22 air sensor", "10 kOhm from data to 5V"),
    Part.DS18B20: ("DS18B20 temperature", "4.7 kOhm from data to 5V, once on the wire"),
    Part.SCD4X: ("SCD4x CO2 sensor", LEVELS),
    Part.BH1750: ("BH1750 light sensor", LEVELS),
    Part.SOIL: ("capacitive soil probe", "supply 5V; its output stays below that"),
    Part.HCSR04: ("HC-SR04 tank level", "above the water, facing down"),
    Part.FLOAT: ("float switch", "to GND; the board pulls the pin up"),
}
BAND, LEFT, RIGHT, WIDTH = 38, 300, 430, 980  # [px] height of a connection, edges of board and parts
WIRE = {"output": "#c0392b", "bus": "#2471a3", "signal": "#1e8449"}


@dataclass(frozen=True, slots=True)
class Connection:
    """One wire. kind : a key of WIRE; note : stands at the first wire of a part"""

    pin: str
    terminal: str
    part: str
    kind: str
    note: str = ""


def connections(block: BoardBlock) -> list[Connection]:
    """Return every wire between board and parts but supply and ground, outputs first."""
    found = [
        Connection(pin_name(pin, block.kind), "IN", OUTPUTS[output][0], "output", _output_note(block, output))
        for output, pin in zip(Output, block.pins, strict=True)
        if pin != NO_PIN
    ]
    for part in block.parts:
        found += _wires(part, block.kind)
    return found


def _output_note(block: BoardBlock, output: Output) -> str:
    # While a board resets its pins float: the resistor decides what the relay does then.
    resistor = "10 kOhm pull-up" if output in block.inverted else "10 kOhm pull-down"
    active = "on while low" if output in block.inverted else "on while high"
    return "; ".join(text for text in (active, resistor, OUTPUTS[output][1]) if text)


def _wires(part: PartConfig, kind: BoardKind) -> Iterator[Connection]:
    name, note = PARTS[part.part]
    if part.outside:
        name += ", outside"
    if part.serial:
        name += f" 28-{part.serial:012x}"
    if part.part in I2C_ADDRESSES:
        data, clock = I2C_PINS[kind]
        yield Connection(data, "SDA", f"{name} at 0x{part.pin:02x}", "bus", note)
        yield Connection(clock, "SCL", f"{name} at 0x{part.pin:02x}", "bus")
        return
    own = pin_name(part.pin, kind)
    if part.part is Part.HCSR04:
        yield Connection(own, "TRIG", name, "signal", note)
        yield Connection(pin_name(part.second, kind), "ECHO", name, "signal")
        return
    terminal = {Part.SOIL: "AOUT", Part.FLOAT: "contact"}.get(part.part, "DATA")
    yield Connection(own, terminal, name, "signal", note)


def wiring_table(block: BoardBlock, with_notes: bool = True) -> Table:
    """Return a row for each wire."""
    columns = 4 if with_notes else 3
    rows = ((one.pin, one.terminal, one.part, one.note)[:columns] for one in connections(block))
    return Table(
        f"{NAMES[block.kind]}, id {block.board_id}",
        ("pin", "to", "part", "mind")[:columns],
        tuple(rows),
        "Every part also needs supply (5V, or as its own sheet says) and GND." if with_notes else "",
        words=True,
    )


def wiring_svg(block: BoardBlock) -> str:
    """Return the picture: the board on the left, its parts on the right, a line for each wire."""
    wires = connections(block)
    height = 100 + BAND * len(wires)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        f'font-size="14" role="img" aria-label="Wiring of {escape(NAMES[block.kind])}">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        f'<rect x="20" y="20" width="{LEFT - 20}" height="{height - 40}" rx="10" fill="#e8f1f2"/>',
        _text(40, 46, NAMES[block.kind], "bold"),
        _text(40, 66, f"id {block.board_id}; 5V and GND to every part"),
    ]
    for number, wire in enumerate(wires):
        is_first = number == 0 or wires[number - 1].part != wire.part
        lines += _wire(wire, 106 + BAND * number, is_first)
    return "\n".join([*lines, "</svg>"]) + "\n"


def _wire(wire: Connection, y: int, is_first: bool) -> Iterator[str]:
    colour = WIRE[wire.kind]
    yield f'<line x1="{LEFT}" y1="{y}" x2="{RIGHT}" y2="{y}" stroke="{colour}" stroke-width="2"/>'
    for x in (LEFT, RIGHT):
        yield f'<circle cx="{x}" cy="{y}" r="4" fill="{colour}"/>'
    yield _text(LEFT - 12, y + 5, wire.pin, "bold", "end")
    yield _text((LEFT + RIGHT) // 2, y - 5, wire.terminal, anchor="middle")
    if is_first:
        yield _text(RIGHT + 12, y, wire.part, "bold")
        yield _text(RIGHT + 12, y + 16, wire.note, size=12)


def _text(x: int, y: int, text: str, weight: str = "normal", anchor: str = "start", size: int = 14) -> str:
    return (
        f'<text x="{x}" y="{y}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}" '
        f'fill="#223">{escape(text)}</text>'
    )
