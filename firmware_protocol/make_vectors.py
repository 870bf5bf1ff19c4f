"""Writes vectors.json and the examples of PROTOCOL.md: `python -m firmware_protocol.make_vectors`.

A vector is what a decoder must make of bytes on the line. Fields are raw integers, as C sees them.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from firmware_protocol.frame import MAX_ENCODED, cobs_encode, crc16, encode
from firmware_protocol.messages import (
    LAYOUTS,
    PROTOCOL_VERSION,
    AirPair,
    AirVerdict,
    BlockCommit,
    BlockPart,
    BlockRead,
    BlockWrite,
    Capability,
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    ErrorCode,
    ErrorMessage,
    HeaterOffCause,
    Hello,
    HelloRequest,
    Maintenance,
    Message,
    Ping,
    Quality,
    ReleaseStop,
    ResetCause,
    SensorReport,
    StateEcho,
    TripCause,
    WirePart,
    WireSearch,
    pack,
)

HERE = Path(__file__).parent
VECTORS = HERE / "vectors.json"
CONTRACT = HERE / "PROTOCOL.md"
BEGIN, END = "<!-- examples: python -m firmware_protocol.make_vectors -->\n", "<!-- end of examples -->\n"


def _crc(payload: bytes) -> bytes:
    return crc16(payload).to_bytes(2, "big")


def _frame(payload: bytes) -> bytes:
    return cobs_encode(payload + _crc(payload)) + b"\0"


def _flip(frame: bytes, at: int, bit: int) -> bytes:
    return frame[:at] + bytes([frame[at] ^ bit]) + frame[at + 1 :]


_HELLO = Hello(
    0x12345678, PROTOCOL_VERSION, PROTOCOL_VERSION, 1, 0, 0, 0x0123456789ABCDEF, ResetCause.POWER_ON, 7,
    Capability(0xFF), 10.0, 45.0, 10.0, 20.0, 1.0, False,
)  # fmt: skip


def report(board_ms: int, *values: float | None, air: Quality = Quality.GOOD) -> SensorReport:
    """Return a report of these values in their order; a signal without one is absent."""
    count = len(LAYOUTS[SensorReport].fields) // 2
    told: list[Any] = []
    for value in (*values, *[None] * (count - len(values))):
        told += [value, Quality.ABSENT if value is None else Quality.GOOD]
    told[1] = air
    return SensorReport(board_ms, *told)


_REPORT = report(60000, 21.3, 55.5, 612, 0.25, 0.4321, 1.0, 20.9)
_BLIND = report(0, air=Quality.FAULT)
_COLD = report(2**32 - 1, -50.0, 0, 0, 0, 0, 0, -0.01, air=Quality.RANGE)
_COMMAND = CommandMessage(10, 1, 50, 2.5, False, 10.0)
_ECHO = StateEcho(61000, 10, HeaterOffCause.NONE, True, 50, True, False, False, TripCause.NONE, 10.0, None)
_TRIPPED = StateEcho(
    61000, 0, HeaterOffCause.TRIPPED, True, 0, False, True, True, TripCause.OVER_TEMPERATURE, 0.0, 1500
)
_MAINTAINED = replace(_TRIPPED, fan_on=False, trip_cause=TripCause.MAINTENANCE, fan_rpm=0)

_WRITE = BlockWrite(1, 0x0706050403020100, 0x0F0E0D0C0B0A0908)

# name, message, seq, ack
_WHOLE: tuple[tuple[str, Message, int, int], ...] = (
    ("hello_request", HelloRequest(0x12345678), 1, 0),
    ("hello", _HELLO, 1, 1),
    ("command", _COMMAND, 2, 0),
    ("state_echo", _ECHO, 3, 2),
    ("sensor_report", _REPORT, 4, 0),
    ("clear_trip", ClearTrip(), 3, 0),
    ("error", ErrorMessage(ErrorCode.TRIPPED, TripCause.OVER_TEMPERATURE), 5, 3),
    ("ping", Ping(), 4, 0),
    ("emergency_stop", EmergencyStop(), 255, 0),
    ("maintenance", Maintenance(), 5, 0),
    ("release_stop", ReleaseStop(), 6, 0),
    ("end_maintenance", EndMaintenance(), 7, 0),
    ("block_read", BlockRead(8), 8, 0),
    ("block_write", _WRITE, 9, 0),
    ("block_commit", BlockCommit(), 10, 0),
    ("block_part", BlockPart(_WRITE.part, _WRITE.low, _WRITE.high), 8, 9),
    ("wire_search", WireSearch(True), 11, 0),
    ("wire_part", WirePart(0x5D00000000000128), 9, 11),
    ("air_pair", AirPair(24.9, 28.1, AirVerdict.APART), 8, 0),
    ("hello unasked after a reset", replace(_HELLO, session=0, boot_count=8), 1, 0),
    ("command of nothing", CommandMessage(0, 0, 0, 0.0, False, 0.0), 1, 0),
    ("command of everything", CommandMessage(20, 255, 100, 25.5, True, 60.0), 255, 0),
    ("command with the fan for 15 s", replace(_COMMAND, fan_on=60, valve_pulse_s=0.0), 2, 0),
    ("sensor_report without a number", _BLIND, 1, 0),
    ("sensor_report of the lowest numbers", _COLD, 255, 0),
    ("state_echo while tripped", _TRIPPED, 6, 0),
    ("state_echo in maintenance", _MAINTAINED, 7, 0),
    ("error none", ErrorMessage(ErrorCode.NONE, 255), 7, 1),
)
_EXAMPLES = 19  # the first of them stand in PROTOCOL.md


def _header(kind: type[Message]) -> bytes:
    return bytes((PROTOCOL_VERSION, LAYOUTS[kind].kind, 9, 0))


def _command_with(offset: int, byte: int) -> bytes:
    body = bytearray(pack(_COMMAND, 9))
    body[4 + offset] = byte
    return bytes(body)


# name, payload, code and detail of the error that it deserves
_REFUSED: tuple[tuple[str, bytes, ErrorCode, int], ...] = (
    ("version 1", b"\1\4\x09\0" + bytes(7), ErrorCode.VERSION, PROTOCOL_VERSION),
    ("version 3, a kind of its own", b"\3\xc8\x09\0xyz", ErrorCode.VERSION, PROTOCOL_VERSION),
    ("kind 0", b"\2\0\x09\0", ErrorCode.UNKNOWN_KIND, 0),
    ("kind 200, the longest body", b"\2\xc8\x09\0" + b"\xff" * 48, ErrorCode.UNKNOWN_KIND, 200),
    ("kind 255", b"\2\xff\x09\0", ErrorCode.UNKNOWN_KIND, 255),
    ("command without a body", _header(CommandMessage), ErrorCode.LENGTH, 0),
    ("command one byte short", pack(_COMMAND, 9)[:-1], ErrorCode.LENGTH, 6),
    ("command one byte long", pack(_COMMAND, 9) + b"\0", ErrorCode.LENGTH, 8),
    ("ping with a body", _header(Ping) + b"\0", ErrorCode.LENGTH, 1),
    ("hello_request one byte short", _header(HelloRequest) + bytes(3), ErrorCode.LENGTH, 3),
    ("command with 21 heater steps", _command_with(0, 21), ErrorCode.RANGE, 0),
    ("command with LED 101", _command_with(2, 101), ErrorCode.RANGE, 2),
    ("command with cut-off 255", _command_with(4, 255), ErrorCode.RANGE, 4),
    ("command with a lease of 60.001 s", pack(_COMMAND, 9)[:-2] + b"\x61\xea", ErrorCode.RANGE, 5),
    ("command, two fields out of range", _command_with(0, 21)[:-2] + b"\xff\xff", ErrorCode.RANGE, 0),
    ("sensor_report at -50.01 degC", pack(_REPORT, 9)[:8] + b"\x77\xec" + pack(_REPORT, 9)[10:],
     ErrorCode.RANGE, 1),
    ("sensor_report with quality 5", pack(_REPORT, 9)[:-1] + b"\5", ErrorCode.RANGE,
     len(LAYOUTS[SensorReport].fields) - 1),
    ("block_write of part 9", pack(_WRITE, 9)[:4] + b"\x09" + pack(_WRITE, 9)[5:], ErrorCode.RANGE, 0),
    ("state_echo with trip cause 5", pack(_ECHO, 9)[:15] + b"\5" + pack(_ECHO, 9)[16:], ErrorCode.RANGE, 8),
)  # fmt: skip

_PING = encode(pack(Ping(), 4))
_LONG = encode(b"\2\xc8\x09\0" + b"\xff" * 48)
# name, bytes on the line, counter that rises, or "" where nothing is dropped
_BROKEN: tuple[tuple[str, bytes, str], ...] = (
    ("idle line", b"\0\0\0", ""),
    ("no end", _PING[:-1], ""),
    ("a bit flipped in the body", _flip(encode(pack(_COMMAND, 2)), 8, 0x04), "bad_crc"),
    ("a bit flipped in the CRC", _flip(_PING, len(_PING) - 2, 0x01), "bad_crc"),
    ("a byte lost", encode(pack(_COMMAND, 2)).replace(b"\x0a", b"", 1), "bad_cobs"),
    ("code byte beyond the end", b"\x05\x01\x02\0", "bad_cobs"),
    ("code byte 255", b"\xff" + b"\1" * 54 + b"\0", "bad_cobs"),
    ("only a code byte", b"\1\0", "too_short"),
    ("a CRC without a header", cobs_encode(b"\xff\xff") + b"\0", "too_short"),
    ("header one byte short, good CRC", _frame(b"\2\7\4"), "too_short"),
    ("body one byte too long, good CRC", _frame(b"\2\xc8\x09\0" + b"\xff" * 49), "too_long"),
    ("longest run and one more", b"\2" * (MAX_ENCODED + 1) + b"\0", "too_long"),
    ("a very long run", b"\x55" * 1000 + b"\0", "too_long"),
    ("CRC in the wrong order", cobs_encode(pack(Ping(), 4) + _crc(pack(Ping(), 4))[::-1]) + b"\0", "bad_crc"),
)
# name, bytes on the line, payloads that must come out
_STREAMS: tuple[tuple[str, bytes, tuple[bytes, ...]], ...] = (
    ("two frames", _PING + _PING, (pack(Ping(), 4),) * 2),
    ("noise, 0x00, a frame", b"\x17\xfe\0" + _PING, (pack(Ping(), 4),)),
    ("noise swallows the frame it touches, not the next", b"\x17\xfe" + _PING * 2, (pack(Ping(), 4),)),
    ("a run too long, then a frame", b"\x55" * 300 + b"\0" + _PING, (pack(Ping(), 4),)),
    ("the longest payload", _LONG, (b"\2\xc8\x09\0" + b"\xff" * 48,)),
)


def vectors() -> list[dict[str, Any]]:
    """All of them. Keys: name, hex (bytes on the line), payloads, and one of

    message : the one whole message, with `fields` as raw integers
    error : code and detail that the one payload deserves
    dropped : name of the decoder's counter that rises by one
    """
    found: list[dict[str, Any]] = []
    for name, message, seq, ack in _WHOLE:
        payload = pack(message, seq, ack)
        found.append(_vector(name, encode(payload), (payload,)) | {"message": _describe(message, seq, ack)})
    for name, payload, code, detail in _REFUSED:
        error = {"code": code.name.lower(), "code_number": int(code), "detail": detail}
        found.append(_vector(name, encode(payload), (payload,)) | {"error": error})
    for name, line, counter in _BROKEN:
        found.append(_vector(name, line, ()) | ({"dropped": counter} if counter else {}))
    return found + [_vector(*stream) for stream in _STREAMS]


def _vector(name: str, line: bytes, payloads: tuple[bytes, ...]) -> dict[str, Any]:
    return {"name": name, "hex": line.hex(), "payloads": [payload.hex() for payload in payloads]}


def _describe(message: Message, seq: int, ack: int) -> dict[str, Any]:
    layout = LAYOUTS[type(message)]
    raws = {field.name: field.to_raw(getattr(message, field.name)) for field in layout.fields}
    return {"class": type(message).__name__, "kind": layout.kind, "seq": seq, "ack": ack, "fields": raws}


def vectors_text() -> str:
    """Text of vectors.json, one vector a line."""
    lines = ",\n".join(json.dumps(vector) for vector in vectors())
    return f"[\n{lines}\n]\n"


def examples_text(found: list[dict[str, Any]]) -> str:
    """Return the worked examples of the contract, from the first vectors."""
    blocks = []
    for vector in found[:_EXAMPLES]:
        payload = vector["payloads"][0]
        fields = "  ".join(f"{name}={raw}" for name, raw in vector["message"]["fields"].items())
        blocks.append(
            f"**{vector['name']}**{': ' if fields else ''}{fields}\n\n```\n"
            f"header  {_space(payload[:8])}\nbody    {_space(payload[8:])}\n"
            f"crc     {_crc(bytes.fromhex(payload)).hex(' ')}\nline    {_space(vector['hex'])}\n```\n"
        )
    return "\n".join(blocks)


def _space(digits: str) -> str:
    return bytes.fromhex(digits).hex(" ")


def contract_with_examples(contract: str, found: list[dict[str, Any]]) -> str:
    """PROTOCOL.md with its examples renewed."""
    before, rest = contract.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{examples_text(found)}\n{END}{after}"


def main() -> int:
    """Write both files."""
    VECTORS.write_text(vectors_text(), encoding="utf-8")
    contract = CONTRACT.read_text(encoding="utf-8")
    CONTRACT.write_text(contract_with_examples(contract, vectors()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
