"""edge/board/board_file.py, wiring.py, `greenhouse board`: from a file of pins to the block of the EEPROM."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.board.board_file import pin_name, read_board_file
from edge.board.wiring import connections, wiring_svg
from edge.core.errors import DataError
from firmware_protocol.board_block import (
    NO_PIN,
    BoardKind,
    Output,
    Part,
    PartConfig,
    decode_block,
    encode_block,
)

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "deploy" / "board.example.yaml"
PICTURES = {"board.example.yaml": "wiring.svg", "board.uno.example.yaml": "wiring_uno.svg"}


def board_file(folder: Path, text: str) -> Path:
    path = folder / "board.yaml"
    path.write_text(text)
    return path


def test_the_example_is_a_block_that_a_board_takes():
    block = read_board_file(EXAMPLE)
    assert decode_block(encode_block(block)) == block
    assert block.pins == (22, 23, 24, 25, 6)
    assert block.parts[4] == PartConfig(Part.SOIL, 54, first=620, last=280)
    assert block.parts[3].first == 2000  # 20 000 lux in steps of 10
    assert (block.temp_trip, block.lease_max_ms) == (4500, 10_000)


def test_an_uno_counts_its_analog_pins_from_14_and_what_is_not_wired_has_no_pin(tmp_path):
    text = (
        "board: uno\nid: 9\noutputs: {fan: {pin: D5, active_low: true}}\nsensors: [{part: float, pin: A3}]\n"
    )
    block = read_board_file(board_file(tmp_path, text))
    assert block.kind is BoardKind.UNO
    assert block.pins == (NO_PIN, 5, NO_PIN, NO_PIN, NO_PIN)
    assert block.inverted == {Output.FAN}
    assert block.parts == (PartConfig(Part.FLOAT, 17, first=1),)


def test_a_serial_number_is_the_one_that_linux_writes(tmp_path):
    text = "board: uno\nid: 1\nsensors: [{part: ds18b20, pin: D2, serial: 28-0123456789ab}]\n"
    block = read_board_file(board_file(tmp_path, text))
    assert block.parts[0].serial == 0x0123456789AB
    assert encode_block(block)[32 + 8 : 32 + 14] == bytes.fromhex("ab8967452301")  # as it comes on the wire


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("board: due\nid: 1\n", "board: 'due' is none of mega2560, uno"),
        ("board: uno\n", "id: missing"),
        (
            "board: uno\nid: 1\nsensors: [{part: soil, pin: A0, dry: 600}]",
            r"sensors\[0\].wet: missing: soil needs",
        ),
        ("board: uno\nid: 1\nsensors: [{part: scd4x, pin: D2}]", r"sensors\[0\].pin: scd4x has no such key"),
        ("board: uno\nid: 1\nsensors: [{part: sht3x, address: 68}]", r"sensors\[0\].address: must be text"),
        ("board: uno\nid: 1\nsensors: [{part: sht3x, address: 0x23}]", "0x23 is not an address of SHT3X"),
        ("board: uno\nid: 1\noutputs: {fan: {pin: D1}}", r"fan: pin 1 cannot serve there \(uno\)"),
        ("board: uno\nid: 1\noutputs: {fan: {pin: 5}}", "outputs.fan.pin: must be text"),
        (
            "board: uno\nid: 1\noutputs: {fan: {pin: D5}, heater: {pin: D5}}",
            "fan: pin 5 already serves as heater",
        ),
        ("board: uno\nid: 1\noutput: {}", "unknown key 'output'"),
        ("board: uno\nid: 1\nlimits: {temp_trip_c: 400}", "limits.temp_trip_c"),
    ],
)
def test_a_mistake_is_named_with_file_and_place(tmp_path, text, why):
    path = board_file(tmp_path, text)
    with pytest.raises(DataError, match=why) as refused:
        read_board_file(path)
    assert str(path) in str(refused.value)


def test_every_wire_is_printed_and_drawn(tmp_path, capsys):
    picture = tmp_path / "wiring.svg"
    assert main(["board", "check", str(EXAMPLE)]) == 0
    printed = capsys.readouterr().out
    assert main(["board", "wiring", str(EXAMPLE), "--out", str(picture)]) == 0
    wires = connections(read_board_file(EXAMPLE))
    assert len(wires) == 15  # five outputs, three parts on two I2C wires, two probes on one, trigger and echo
    assert all(f"{wire.pin:8}" in printed and wire.part in printed for wire in wires)
    texts = [item.text for item in ElementTree.parse(picture).iter("{http://www.w3.org/2000/svg}text")]
    assert [texts.count(wire.pin) for wire in wires] == [
        [one.pin for one in wires].count(w.pin) for w in wires
    ]
    assert {wire.part for wire in wires} <= set(texts)


@pytest.mark.parametrize("name", PICTURES)
def test_the_manuals_pictures_are_those_of_the_examples(name):
    drawn = wiring_svg(read_board_file(ROOT / "deploy" / name))
    assert (ROOT / "docs" / "images" / PICTURES[name]).read_text() == drawn


def test_nothing_is_drawn_below_or_beside_the_picture():
    root = ElementTree.fromstring(wiring_svg(read_board_file(EXAMPLE)))
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    for line in root.iter("{http://www.w3.org/2000/svg}line"):
        assert 0 < float(line.attrib["x2"]) < width and 0 < float(line.attrib["y2"]) < height - 20


def test_a_wrong_file_ends_in_one_line_and_code_2(tmp_path, capsys):
    assert main(["board", "check", str(tmp_path / "none.yaml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "none.yaml" in line


def test_pins_have_the_names_that_are_printed_on_the_board():
    assert [pin_name(pin, BoardKind.UNO) for pin in (13, 14, NO_PIN)] == ["D13", "A0", "-"]
    assert [pin_name(pin, BoardKind.MEGA2560) for pin in (53, 54, 69)] == ["D53", "A0", "A15"]
