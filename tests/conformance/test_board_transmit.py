"""The C board's buffer for the line, when nobody takes the bytes out."""

import ctypes

from board_bench import CONFIG

from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import ErrorMessage, Hello, HelloRequest, Ping, StateEcho, pack, unpack
from tests.support.c_core import CBoardCore

TRANSMIT_SIZE = 192
HELLO, PING = encode(pack(HelloRequest(1), 1)), encode(pack(Ping(), 2))
UNKNOWN_KIND = encode(bytes((1, 200, 3, 0)))


class JammedBoard(CBoardCore):
    """A C board whose UART takes nothing before it is asked to."""

    def _drain(self) -> None:
        pass

    def take(self, size: int) -> bytes:
        out = ctypes.create_string_buffer(size)
        moved = self._library.gh_board_transmit(self._board, out, size)
        return out.raw[:moved]


def test_frames_fill_the_buffer_to_its_last_byte_and_the_next_is_dropped_whole():
    board = JammedBoard(CONFIG, b"", 0, 1)  # its hello is 43 bytes long, as the next; a state 24, an error 10
    for request in (HELLO, PING, PING, PING, PING, UNKNOWN_KIND):
        board.receive(request, 0)
    for _ in range(50):
        board.receive(PING + UNKNOWN_KIND, 0)
    told = board.take(1000)
    assert len(told) == TRANSMIT_SIZE
    messages = [unpack(payload)[1] for payload in FrameDecoder().feed(told)]
    assert [type(message) for message in messages] == [Hello, Hello, *[StateEcho] * 4, ErrorMessage]
    assert board.take(1000) == b""
    board.receive(PING, 0)
    assert len(board.take(1000)) == 24


def test_one_byte_short_of_room_drops_the_frame():
    board = JammedBoard(CONFIG, b"", 0, 1)
    for request in (HELLO, PING, PING, PING, PING):
        board.receive(request, 0)
    assert board.take(0) == b""
    assert len(board.take(13)) == 13  # leaves 169 of 192 bytes: 23 of room
    board.receive(PING, 0)
    assert len(board.take(1000)) == 43 + 43 + 4 * 24 - 13


def test_it_does_not_matter_in_what_pieces_the_bytes_are_taken():
    whole, pieces = JammedBoard(CONFIG, b"", 0, 1), JammedBoard(CONFIG, b"", 0, 1)
    for board in (whole, pieces):
        board.receive(HELLO + PING, 0)
    taken = [pieces.take(size) for size in (1, 2, 3, 50, 0, 100)]
    assert [len(piece) for piece in taken] == [1, 2, 3, 50, 0, 54]
    assert b"".join(taken) == whole.take(1000)
