"""The golden vectors: the code against the file, the file against its generator, a second CRC and COBS."""

import json
from typing import Any

import pytest

from firmware_protocol import make_vectors
from firmware_protocol.errors import DecodeError
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import CLASS_OF_KIND, LAYOUT_OF_KIND, pack, unpack

VECTORS: list[dict[str, Any]] = json.loads(make_vectors.VECTORS.read_text(encoding="utf-8"))
COUNTERS = ("too_long", "bad_cobs", "too_short", "bad_crc")


def named(key: str) -> list[Any]:
    return [pytest.param(vector, id=vector["name"]) for vector in VECTORS if key in vector]


def payloads(vector: dict[str, Any]) -> list[bytes]:
    return [bytes.fromhex(payload) for payload in vector["payloads"]]


def bitwise_crc(data: bytes) -> int:
    """CRC-16/IBM-3740 from its definition, one bit at a time."""
    crc = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (crc >> 15) ^ (byte >> bit & 1)
            crc = (crc << 1 & 0xFFFF) ^ (0x1021 if carry else 0)
    return crc


def plain_cobs(data: bytes) -> bytes:
    """COBS of fewer than 254 bytes: each zero gives way to the distance to the next one."""
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0"))


@pytest.mark.parametrize("vector", named("payloads"))
def test_the_decoder_makes_of_the_line_what_the_vector_says(vector: dict[str, Any]) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(bytes.fromhex(vector["hex"])) == payloads(vector)
    if "message" in vector or "error" in vector:
        assert decoder.nonsense == 0


@pytest.mark.parametrize("vector", named("payloads"))
def test_byte_by_byte_gives_the_same(vector: dict[str, Any]) -> None:
    decoder = FrameDecoder()
    found = [payload for byte in bytes.fromhex(vector["hex"]) for payload in decoder.feed(bytes([byte]))]
    assert found == payloads(vector)


@pytest.mark.parametrize("vector", named("dropped"))
def test_what_is_broken_is_counted_where_the_vector_says(vector: dict[str, Any]) -> None:
    decoder = FrameDecoder()
    decoder.feed(bytes.fromhex(vector["hex"]))
    counts = {name: getattr(decoder, name) for name in COUNTERS}
    assert counts == dict.fromkeys(COUNTERS, 0) | {vector["dropped"]: 1}


@pytest.mark.parametrize("vector", named("message"))
def test_a_whole_message_decodes_to_its_fields_and_back_to_its_bytes(vector: dict[str, Any]) -> None:
    expected = vector["message"]
    header, message = unpack(payloads(vector)[0])
    layout = LAYOUT_OF_KIND[expected["kind"]]
    assert (header.kind, header.seq, header.ack) == (expected["kind"], expected["seq"], expected["ack"])
    assert type(message).__name__ == expected["class"]
    assert {f.name: f.to_raw(getattr(message, f.name)) for f in layout.fields} == expected["fields"]
    assert encode(pack(message, header.seq, header.ack)).hex() == vector["hex"]


@pytest.mark.parametrize("vector", named("error"))
def test_a_whole_frame_without_meaning_deserves_the_error_of_the_vector(vector: dict[str, Any]) -> None:
    with pytest.raises(DecodeError) as raised:
        unpack(payloads(vector)[0])
    expected = vector["error"]
    assert (raised.value.code, raised.value.detail) == (expected["code_number"], expected["detail"])


@pytest.mark.parametrize("vector", named("message") + named("error"))
def test_frames_agree_with_a_second_crc_and_cobs(vector: dict[str, Any]) -> None:
    payload = payloads(vector)[0]
    frame = plain_cobs(payload + bitwise_crc(payload).to_bytes(2, "big")) + b"\0"
    assert frame.hex() == vector["hex"]


def test_every_kind_of_message_has_a_vector() -> None:
    shown = {vector["message"]["class"] for vector in VECTORS if "message" in vector}
    assert shown == {message_class.__name__ for message_class in CLASS_OF_KIND.values()}


def test_no_two_vectors_have_one_name() -> None:
    names = [vector["name"] for vector in VECTORS]
    assert sorted(set(names)) == sorted(names)


def test_the_file_is_what_the_generator_writes() -> None:
    assert make_vectors.VECTORS.read_text(encoding="utf-8") == make_vectors.vectors_text()


def test_the_contract_shows_the_examples_of_the_file() -> None:
    contract = make_vectors.CONTRACT.read_text(encoding="utf-8")
    assert make_vectors.contract_with_examples(contract, VECTORS) == contract
