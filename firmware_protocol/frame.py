"""Frames: COBS(payload, CRC-16/IBM-3740) and one 0x00. Bytes in, payloads out.

COBS: Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2), 1999.
"""

import binascii

from firmware_protocol.messages import HEADER_LENGTH, MAX_BODY

CRC_LENGTH = 2
MIN_PAYLOAD = HEADER_LENGTH
MAX_PAYLOAD = HEADER_LENGTH + MAX_BODY
MAX_ENCODED = MAX_PAYLOAD + CRC_LENGTH + 1  # COBS adds one byte below 254; the 0x00 is not counted
_LONGEST_BLOCK = 254  # bytes without a zero that one COBS code byte can announce


def crc16(data: bytes) -> int:
    """CRC-16/IBM-3740: polynomial 0x1021, initial 0xFFFF; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Encode `data` without a zero byte; one byte longer for each 254 begun."""
    out = bytearray()
    *blocks, last = data.split(b"\0")
    for block in blocks:
        _put_block(out, block)
    if len(last) >= _LONGEST_BLOCK and len(last) % _LONGEST_BLOCK == 0:
        _put_full_blocks(out, last)  # a full last block implies no zero: nothing has to follow it
    else:
        _put_block(out, last)
    return bytes(out)


def _put_block(out: bytearray, block: bytes) -> None:
    full = len(block) // _LONGEST_BLOCK * _LONGEST_BLOCK
    _put_full_blocks(out, block[:full])
    out.append(len(block) - full + 1)
    out += block[full:]


def _put_full_blocks(out: bytearray, block: bytes) -> None:
    for start in range(0, len(block), _LONGEST_BLOCK):
        out.append(_LONGEST_BLOCK + 1)
        out += block[start : start + _LONGEST_BLOCK]


def cobs_decode(encoded: bytes) -> bytes | None:
    """Decode `encoded`; None for invalid COBS: empty, holding a zero, or ending inside a block."""
    if not encoded or 0 in encoded:
        return None
    out = bytearray()
    at, size = 0, len(encoded)
    while at < size:
        code = encoded[at]
        end = at + code
        if end > size:
            return None
        out += encoded[at + 1 : end]
        if code <= _LONGEST_BLOCK and end < size:
            out.append(0)
        at = end
    return bytes(out)


def encode(payload: bytes) -> bytes:
    """Return the frame that carries a payload of MIN_PAYLOAD to MAX_PAYLOAD
    bytes. Raises ValueError otherwise
    """
    if not MIN_PAYLOAD <= len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"a payload of {len(payload)} bytes; {MIN_PAYLOAD} to {MAX_PAYLOAD} can be framed")
    return cobs_encode(payload + crc16(payload).to_bytes(CRC_LENGTH, "big")) + b"\0"


class FrameDecoder:
    """Cuts a stream of bytes into payloads; counts what is none and goes on at the next 0x00."""

    def __init__(self) -> None:
        self.too_long = 0  # runs without a 0x00 that no frame can be
        self.bad_cobs = 0
        self.too_short = 0  # COBS, but no room for header and CRC
        self.bad_crc = 0
        self._run = bytearray()  # since the last 0x00, at most MAX_ENCODED + 1 bytes

    @property
    def nonsense(self) -> int:
        """All that was dropped so far."""
        return self.too_long + self.bad_cobs + self.too_short + self.bad_crc

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads that `data` completes, each MIN_PAYLOAD to
        MAX_PAYLOAD bytes with a good CRC.
        """
        *complete, rest = data.split(b"\0")
        payloads = []
        for piece in complete:
            self._append(piece)
            payload = self._payload(bytes(self._run))
            self._run.clear()
            if payload is not None:
                payloads.append(payload)
        self._append(rest)
        return payloads

    def reset(self) -> None:
        """Forget half a frame: the line was cut."""
        self._run.clear()

    def _append(self, piece: bytes) -> None:
        self._run += piece[: MAX_ENCODED + 1 - len(self._run)]  # one byte too many marks a run as too long

    def _payload(self, run: bytes) -> bytes | None:
        if not run:
            return None  # idle line
        if len(run) > MAX_ENCODED:
            self.too_long += 1
            return None
        data = cobs_decode(run)
        if data is None:
            self.bad_cobs += 1
        elif len(data) < MIN_PAYLOAD + CRC_LENGTH:
            self.too_short += 1
        elif crc16(data):  # the CRC over data and its own CRC is 0
            self.bad_crc += 1
        else:
            return data[:-CRC_LENGTH]
        return None
