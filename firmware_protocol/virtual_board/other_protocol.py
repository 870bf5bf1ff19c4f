"""A board of another protocol version: the firmware of this one, all frames said to be of that version."""

from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import LAYOUTS, ErrorCode, ErrorMessage, Hello, read_header

_HELLO, _ERROR = LAYOUTS[Hello].kind, LAYOUTS[ErrorMessage].kind
_VERSION, _BODY = 0, 4  # where a payload has its version, and its body
_SESSION_LENGTH = 4  # of hello; protocol_min and protocol_max follow


class OtherProtocol:
    """Stands between the line and the firmware."""

    def __init__(self, version: int) -> None:
        self.version = version
        self._from_host = FrameDecoder()
        self._from_firmware = FrameDecoder()

    def to_firmware(self, data: bytes) -> bytes:
        """The host's version is foreign to this board."""
        return b"".join(self._frame(bytearray(payload)) for payload in self._from_host.feed(data))

    def to_host(self, data: bytes) -> bytes:
        """What this board says is of its version, and it says so."""
        frames = b""
        for received in self._from_firmware.feed(data):
            payload = bytearray(received)
            kind = read_header(received).kind
            if kind == _HELLO:
                first = _BODY + _SESSION_LENGTH
                payload[first : first + 2] = bytes([self.version] * 2)
            elif kind == _ERROR and payload[_BODY] == ErrorCode.VERSION:
                payload[_BODY + 1] = self.version
            frames += self._frame(payload)
        return frames

    def _frame(self, payload: bytearray) -> bytes:
        payload[_VERSION] = self.version
        return encode(bytes(payload))
