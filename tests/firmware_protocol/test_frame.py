"""Frames: COBS, CRC-16/IBM-3740 and the decoder, at the edges of every length."""

import random
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import DecodeError
from firmware_protocol.frame import (
    MAX_ENCODED,
    MAX_PAYLOAD,
    MIN_PAYLOAD,
    FrameDecoder,
    cobs_decode,
    cobs_encode,
    crc16,
    encode,
)
from firmware_protocol.messages import CommandMessage, pack, unpack

UP = bytes(range(1, 256))  # 1..255
# from the table of examples of the Wikipedia article on COBS
KNOWN_COBS = [
    (b"", b"\1"),
    (b"\0", b"\1\1"),
    (b"\0\0", b"\1\1\1"),
    (b"\0\x11\0", b"\1\2\x11\1"),
    (b"\x11\x22\0\x33", b"\3\x11\x22\2\x33"),
    (b"\x11\x22\x33\x44", b"\5\x11\x22\x33\x44"),
    (b"\x11\0\0\0", b"\2\x11\1\1\1"),
    (UP[:254], b"\xff" + UP[:254]),
    (b"\0" + UP[:254], b"\1\xff" + UP[:254]),
    (UP, b"\xff" + UP[:254] + b"\2\xff"),
    (UP[1:] + b"\0", b"\xff" + UP[1:] + b"\1\1"),
    (UP[2:] + b"\0\1", b"\xfe" + UP[2:] + b"\2\1"),
]
EDGES = [0, 1, 2, 253, 254, 255, 256, 507, 508, 509, 762]


def payload_of(length: int, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(length)


def test_the_crc_has_its_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1


@pytest.mark.parametrize(("data", "encoded"), KNOWN_COBS, ids=range(len(KNOWN_COBS)))
def test_cobs_agrees_with_published_examples_both_ways(data: bytes, encoded: bytes) -> None:
    assert cobs_encode(data) == encoded
    assert cobs_decode(encoded) == data


@pytest.mark.parametrize("length", EDGES)
@pytest.mark.parametrize("byte", [b"\0", b"\1", b"\xff"])
def test_cobs_holds_at_the_edges_of_a_block(length: int, byte: bytes) -> None:
    data = byte * length
    for variant in (data, data + b"\0", b"\0" + data, data + b"\0" + data):
        encoded = cobs_encode(variant)
        assert 0 not in encoded
        assert cobs_decode(encoded) == variant


@given(st.binary(max_size=600))
def test_cobs_gives_back_any_bytes_and_takes_out_every_zero(data: bytes) -> None:
    encoded = cobs_encode(data)
    assert 0 not in encoded
    assert len(encoded) <= len(data) + 1 + len(data) // 254
    assert cobs_decode(encoded) == data


@pytest.mark.parametrize("encoded", [b"", b"\0", b"\2", b"\3\1", b"\1\0", b"\xff" + b"\1" * 253, b"\1\5\1"])
def test_what_is_no_cobs_decodes_to_nothing(encoded: bytes) -> None:
    assert cobs_decode(encoded) is None


@pytest.mark.parametrize("length", [MIN_PAYLOAD, MIN_PAYLOAD + 1, MAX_PAYLOAD - 1, MAX_PAYLOAD])
def test_a_payload_of_a_lawful_length_comes_through(length: int) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(encode(payload_of(length))) == [payload_of(length)]
    assert decoder.nonsense == 0


@pytest.mark.parametrize("length", [0, 1, MIN_PAYLOAD - 1, MAX_PAYLOAD + 1, 253, 254, 255])
def test_a_payload_of_another_length_is_not_framed(length: int) -> None:
    with pytest.raises(ValueError, match=f"{length} bytes"):
        encode(payload_of(length))


@pytest.mark.parametrize("length", [0, 1, MIN_PAYLOAD - 1, MAX_PAYLOAD + 1, 253, 254, 255])
def test_a_frame_of_another_length_is_dropped_though_its_crc_is_good(length: int) -> None:
    payload = payload_of(length)
    decoder = FrameDecoder()
    assert decoder.feed(cobs_encode(payload + crc16(payload).to_bytes(2, "big")) + b"\0") == []
    assert (decoder.too_short, decoder.too_long) == ((1, 0) if length < MIN_PAYLOAD else (0, 1))


@pytest.mark.parametrize("length", [MAX_ENCODED, MAX_ENCODED + 1, MAX_ENCODED + 2, 1000])
def test_only_a_run_beyond_the_longest_frame_is_too_long(length: int) -> None:
    decoder = FrameDecoder()
    decoder.feed(b"\1" * length + b"\0")
    assert decoder.too_long == (length > MAX_ENCODED)
    assert decoder.nonsense == 1


def test_a_run_too_long_counts_once_however_it_arrives() -> None:
    decoder = FrameDecoder()
    for _ in range(20):
        decoder.feed(b"\7" * 50)
    decoder.feed(b"\0")
    assert decoder.too_long == 1


def test_half_a_frame_is_forgotten_by_a_reset() -> None:
    frame = encode(b"\1\7\4\0")
    decoder = FrameDecoder()
    decoder.feed(frame[:5])
    decoder.reset()
    assert decoder.feed(frame) == [b"\1\7\4\0"]


def commands() -> list[bytes]:
    """Payloads of commands, some with a CRC that ends in 0x00: that is good without this byte too."""
    payloads = [pack(CommandMessage(20, True, 50, 2.5, False, ms / 1000), 7) for ms in range(10000, 10400)]
    assert any(crc16(payload) & 0xFF == 0 for payload in payloads)
    return payloads


def heard(line: bytes) -> list[bytes]:
    """The payloads that a receiver takes for a message."""
    taken = []
    for payload in FrameDecoder().feed(line):
        with suppress(DecodeError):
            unpack(payload)
            taken.append(payload)
    return taken


def test_every_single_flipped_bit_is_found() -> None:
    for payload in commands():
        frame = encode(payload)
        for at in range(len(frame)):
            for bit in range(8):
                bent = frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]
                assert heard(bent + b"\0") == [], (payload, at, bit)


def test_every_single_lost_byte_is_found() -> None:
    for payload in commands():
        frame = encode(payload)
        for at in range(len(frame) - 1):
            assert heard(frame[:at] + frame[at + 1 :]) == [], (payload, at)


@given(st.binary(max_size=400), st.binary(min_size=MIN_PAYLOAD, max_size=MAX_PAYLOAD))
def test_after_any_bytes_the_frame_behind_the_next_zero_is_heard(noise: bytes, payload: bytes) -> None:
    assert FrameDecoder().feed(noise + b"\0" + encode(payload))[-1:] == [payload]


@given(st.lists(st.binary(max_size=100)))
def test_it_does_not_matter_how_the_bytes_are_cut(pieces: list[bytes]) -> None:
    one, other = FrameDecoder(), FrameDecoder()
    found = [payload for piece in pieces for payload in one.feed(piece)]
    assert found == other.feed(b"".join(pieces))
    assert one.nonsense == other.nonsense


@given(st.binary(max_size=400))
def test_any_bytes_give_lawful_payloads_or_a_count(noise: bytes) -> None:
    decoder = FrameDecoder()
    payloads = decoder.feed(noise)
    assert all(MIN_PAYLOAD <= len(payload) <= MAX_PAYLOAD for payload in payloads)
    runs = sum(bool(run) for run in noise.split(b"\0")[:-1])
    assert len(payloads) + decoder.nonsense == runs
