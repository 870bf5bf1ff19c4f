"""board_block.py and c/gh_config.c: one block, one set of rules on both sides."""

import ctypes
import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.board_block import (
    BLOCK_SIZE,
    I2C_ADDRESSES,
    NO_PIN,
    PARTS_MAX,
    RANGES,
    BoardBlock,
    BoardKind,
    Output,
    Part,
    PartConfig,
    decode_block,
    encode_block,
)
from firmware_protocol.frame import crc16
from tests.support.c_core import load_board

RIG = BoardBlock(
    BoardKind.MEGA2560,
    board_id=77,
    pins=(22, 23, 24, 25, 6),
    inverted=frozenset({Output.FAN}),
    parts=(
        PartConfig(Part.SHT4X, 0x44),
        PartConfig(Part.DS18B20, 30, serial=0x0123456789AB),
        PartConfig(Part.DS18B20, 30, outside=True, serial=2),
        PartConfig(Part.SCD4X, 0x62),
        PartConfig(Part.BH1750, 0x23, first=2000),
        PartConfig(Part.SOIL, 54, first=620, last=280),
        PartConfig(Part.HCSR04, 31, second=50, first=180, last=30),
    ),
)
UNO = BoardBlock(
    BoardKind.UNO,
    board_id=1,
    pins=(4, 5, 6, 7, 3),
    parts=(PartConfig(Part.DHT22, 2), PartConfig(Part.FLOAT, 8)),
)


def c_accepts(data: bytes, kind: BoardKind) -> bool:
    """gh_config_read; the structure is larger than any the compiler makes of it."""
    read = load_board().gh_config_read
    read.restype = ctypes.c_bool
    return bool(read(data, ctypes.c_int(kind), ctypes.create_string_buffer(1024)))


def accepts(data: bytes, kind: BoardKind) -> bool:
    try:
        return decode_block(data).kind is kind
    except ValueError:
        return False


def signed(body: bytes) -> bytes:
    """A block whose CRC is right, whatever it says."""
    return crc16(body).to_bytes(2, "little") + body


@pytest.mark.parametrize("block", [RIG, UNO, BoardBlock(BoardKind.UNO, 1)])
def test_a_block_comes_back_as_it_was_and_the_board_takes_it(block):
    data = encode_block(block)
    assert len(data) == BLOCK_SIZE
    assert decode_block(data) == block
    assert c_accepts(data, block.kind)


def test_a_block_for_another_microcontroller_is_refused():
    assert not c_accepts(encode_block(UNO), BoardKind.MEGA2560)
    assert not c_accepts(encode_block(RIG), BoardKind.UNO)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\xff" * BLOCK_SIZE, "blank"),
        (b"\0" * BLOCK_SIZE, "damaged"),
        (encode_block(RIG)[:-1] + b"\1", "damaged"),
        (encode_block(RIG)[:-1], "143 bytes"),
        (signed(encode_block(UNO)[2:-1] + b"\1"), "mean nothing"),
        (signed(b"\2" + encode_block(UNO)[3:]), "layout 2"),
    ],
)
def test_a_blank_damaged_or_newer_block_is_refused_by_name(data, why):
    with pytest.raises(ValueError, match=why):
        decode_block(data)
    assert len(data) < BLOCK_SIZE or not c_accepts(data, BoardKind.UNO)


PINS = (22, 23, 24, 25, 6)
WRONG = [
    (replace(RIG, lease_max_ms=99), "lease_max_ms"),
    (replace(RIG, board_id=0), "board_id"),
    (replace(RIG, pins=(22, 22, 24, 25, 6)), "fan: pin 22 already serves as heater"),
    (replace(RIG, pins=(1, 23, 24, 25, 6)), "heater: pin 1 cannot"),
    (replace(RIG, pins=(20, 23, 24, 25, 6)), "heater: pin 20 cannot"),
    (replace(RIG, pins=(22, 23, 24, 25, 5)), "led: pin 5 cannot"),
    (replace(UNO, pins=(18, 5, 6, 7, 3)), "heater: pin 18 cannot"),
    (replace(RIG, parts=RIG.parts[:1] * 9), "room for 8"),
    (replace(RIG, parts=(PartConfig(Part.SHT4X, 0x23),)), "0x23 is not an address"),
    (replace(RIG, parts=(PartConfig(Part.SHT4X, 0x44), PartConfig(Part.SHT3X, 0x44))), "used twice"),
    (replace(RIG, parts=(PartConfig(Part.SCD4X, 0x62, outside=True),)), "inside only"),
    (replace(RIG, parts=(PartConfig(Part.DHT22, 30),)), "pin 30 cannot"),
    (
        replace(RIG, parts=(PartConfig(Part.HCSR04, 31, 50, first=90, last=30), PartConfig(Part.FLOAT, 40))),
        "tank_level is",
    ),
    (replace(RIG, parts=(*RIG.parts[:2], PartConfig(Part.DHT22, 10))), "temp_air is measured by 2"),
    (
        replace(RIG, parts=(*RIG.parts[:3], PartConfig(Part.SHT3X, 0x45, outside=True))),
        "temp_ambient is measured by 1",
    ),
    (
        replace(RIG, parts=(PartConfig(Part.DS18B20, 30), PartConfig(Part.DS18B20, 30, serial=1))),
        "serial numbers",
    ),
    (
        replace(RIG, parts=(PartConfig(Part.DS18B20, 30, serial=1), PartConfig(Part.DS18B20, 31, serial=2))),
        "one pin",
    ),
    (replace(RIG, parts=(PartConfig(Part.SOIL, 54, first=300, last=310),)), "do not suit SOIL"),
    (replace(RIG, parts=(PartConfig(Part.HCSR04, 31, first=180, last=30),)), "second pin"),
    (replace(RIG, parts=(PartConfig(Part.HCSR04, 31, second=50, first=30, last=180),)), "do not suit HCSR04"),
    (replace(RIG, parts=(PartConfig(Part.BH1750, 0x23),)), "do not suit BH1750"),
    (replace(RIG, parts=(PartConfig(Part.FLOAT, 40, first=2),)), "do not suit FLOAT"),
    (replace(RIG, parts=(PartConfig(Part.FLOAT, 40, serial=3),)), "no serial number"),
]


@pytest.mark.parametrize(("block", "why"), WRONG)
def test_a_rule_that_is_broken_is_named(block, why):
    with pytest.raises(ValueError, match=why):
        encode_block(block)


# Blocks of any kind, most of them wrong somewhere.
numbers = st.sampled_from([0, 1, 3, 4, 19, 20, 280, 620, 1019, 1020, 4000, 4001, 5461, 5462, -1])
pins = st.sampled_from([0, 1, 2, 3, 6, 8, 9, 10, 11, 13, 14, 17, 18, 20, 21, 22, 50, 53, 54, 69, 70, NO_PIN])
places = st.one_of(pins, st.sampled_from([address for known in I2C_ADDRESSES.values() for address in known]))
parts = st.builds(
    PartConfig, st.sampled_from(Part), places, pins, st.booleans(), numbers, numbers, st.integers(0, 2)
)
limits = {name: st.sampled_from([low - (low > 0), low, high]) for name, (low, high) in RANGES.items()}
blocks = st.builds(
    BoardBlock,
    st.sampled_from(BoardKind),
    pins=st.tuples(*[pins] * 5),
    inverted=st.frozensets(st.sampled_from(Output)),
    parts=st.lists(parts, max_size=PARTS_MAX).map(tuple),
    **limits,
)


def unchecked(block: BoardBlock, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The bytes of a block that nobody checked."""
    with monkeypatch.context() as patch:
        patch.setattr("firmware_protocol.board_block.block_problem", lambda block: "")
        return encode_block(block)


@pytest.mark.slow
@settings(max_examples=600, deadline=None)
@given(block=blocks)
def test_both_sides_refuse_the_same_blocks(block):
    with pytest.MonkeyPatch.context() as patch:
        data = unchecked(block, patch)
    for kind in BoardKind:
        assert accepts(data, kind) == c_accepts(data, kind)


@settings(max_examples=300, deadline=None)
@given(part=parts, kind=st.sampled_from(BoardKind))
def test_both_sides_refuse_the_same_single_parts(part, kind):
    with pytest.MonkeyPatch.context() as patch:
        data = unchecked(BoardBlock(kind, 1, parts=(part,)), patch)
    assert accepts(data, kind) == c_accepts(data, kind)


@pytest.mark.parametrize("part", Part)
@pytest.mark.parametrize("kind", BoardKind)
def test_every_part_can_be_configured_and_both_sides_agree_pin_by_pin(part, kind, monkeypatch):
    numbers = {Part.SOIL: (620, 280), Part.HCSR04: (180, 30), Part.BH1750: (2000, 0)}
    first, last = numbers.get(part, (0, 0))
    second = 50 if kind is BoardKind.MEGA2560 else 9
    taken = 0
    for pin in range(256):
        one = PartConfig(part, pin, second if part is Part.HCSR04 else NO_PIN, first=first, last=last)
        data = unchecked(BoardBlock(kind, 1, parts=(one,)), monkeypatch)
        assert accepts(data, kind) == c_accepts(data, kind)
        taken += accepts(data, kind)
    assert taken


def test_no_change_of_bytes_is_taken_by_one_side_alone():
    noise = random.Random(1)
    for _ in range(3000):
        body = bytearray(encode_block(noise.choice([RIG, UNO]))[2:])
        for _ in range(noise.randint(1, 3)):
            body[noise.randrange(len(body))] = noise.choice([0, 1, 2, 255, noise.randrange(256)])
        data = signed(bytes(body))
        for kind in BoardKind:
            assert accepts(data, kind) == c_accepts(data, kind)
