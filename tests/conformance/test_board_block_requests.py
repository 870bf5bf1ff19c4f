"""The configuration over the line: read, written, taken into force, refused."""

from dataclasses import replace

import pytest
from board_bench import CONFIGURABLE, HEAT, IDLE, BoardBench, heating, is_error

from firmware_protocol.board_block import BLOCK_SIZE, NO_PIN, PART_BYTES, BoardBlock, BoardKind, encode_block
from firmware_protocol.frame import encode
from firmware_protocol.messages import (
    BlockCommit,
    BlockPart,
    BlockRead,
    BlockWrite,
    ErrorCode,
    StateEcho,
    WireSearch,
    pack,
)

PARTS = BLOCK_SIZE // PART_BYTES
BLOCK = encode_block(BoardBlock(BoardKind.UNO, board_id=7, pins=(4, 5, NO_PIN, NO_PIN, NO_PIN)))
BLANK = b"\xff" * BLOCK_SIZE


def written(part: int, block: bytes = BLOCK) -> BlockWrite:
    data = block[part * PART_BYTES :][:PART_BYTES]
    return BlockWrite(part, int.from_bytes(data[:8], "little"), int.from_bytes(data[8:], "little"))


def write_all(bench: BoardBench, block: bytes = BLOCK) -> None:
    for part in range(PARTS):
        wanted = written(part, block)
        assert bench.ask(wanted) == BlockPart(part, wanted.low, wanted.high)


def block_of(bench: BoardBench) -> bytes:
    parts = [bench.ask(BlockRead(part)) for part in range(PARTS)]
    assert [part.part for part in parts] == list(range(PARTS))
    return b"".join(part.low.to_bytes(8, "little") + part.high.to_bytes(8, "little") for part in parts)


@pytest.fixture
def bench(new_board):
    return BoardBench(new_board, CONFIGURABLE).greet().air(25.0)


def test_a_new_board_has_a_blank_block(bench):
    assert block_of(bench) == BLANK
    assert not bench.board.restart


def test_what_was_written_is_in_force_only_after_the_commit(bench):
    write_all(bench)
    assert block_of(bench) == BLANK and not bench.board.restart
    assert isinstance(bench.ask(BlockCommit()), StateEcho)
    assert block_of(bench) == BLOCK and bench.board.restart


@pytest.mark.parametrize("lacking", range(PARTS))
def test_a_block_that_lacks_a_part_is_not_taken(bench, lacking):
    for part in set(range(PARTS)) - {lacking}:
        bench.ask(written(part))
    assert is_error(bench.ask(BlockCommit()), ErrorCode.BAD_BLOCK, 0)
    assert block_of(bench) == BLANK and not bench.board.restart
    bench.ask(written(lacking))
    assert isinstance(bench.ask(BlockCommit()), StateEcho)


def test_a_block_of_another_microcontroller_is_not_taken(bench):
    write_all(bench, encode_block(BoardBlock(BoardKind.MEGA2560, board_id=7, pins=(4, 5) + (NO_PIN,) * 3)))
    assert is_error(bench.ask(BlockCommit()), ErrorCode.BAD_BLOCK, 0)


def test_nothing_is_changed_while_the_heater_is_driven(new_board):
    bench = heating(new_board, config=CONFIGURABLE)
    assert is_error(bench.ask(written(0)), ErrorCode.HEATING, HEAT.heater_steps)
    assert is_error(bench.ask(BlockCommit()), ErrorCode.HEATING, HEAT.heater_steps)
    assert is_error(bench.ask(WireSearch(True)), ErrorCode.HEATING, HEAT.heater_steps)
    assert block_of(bench) == BLANK
    bench.ask(IDLE)
    write_all(bench)
    bench.ask(replace(HEAT, heater_steps=1))
    assert is_error(bench.ask(BlockCommit()), ErrorCode.HEATING, 1)
    bench.ask(IDLE)
    assert isinstance(bench.ask(BlockCommit()), StateEcho)


def test_a_commit_that_comes_twice_is_answered_twice_and_done_once(bench):
    write_all(bench)
    first, second = (bench.ask(BlockCommit(), seq=200) for _ in range(2))
    assert first == second
    write_all(bench, BLANK)
    assert block_of(bench) == BLOCK


def test_the_parts_on_the_wire_are_found_one_after_the_other(bench):
    found = [bench.ask(WireSearch(first)).rom for first in (True, False, False, False, False, True)]
    assert found == [0x28, 0x128, 0x228, 0, 0, 0x28]


REQUESTS = [BlockRead(0), written(0), BlockCommit(), WireSearch(True)]


@pytest.mark.parametrize("request_", REQUESTS)
def test_nothing_is_obeyed_before_the_greeting(new_board, request_):
    bench = BoardBench(new_board, CONFIGURABLE).air(25.0)
    assert is_error(bench.ask(request_), ErrorCode.NOT_GREETED, pack(request_, 1)[1])


@pytest.mark.parametrize("request_", REQUESTS)
def test_a_board_that_cannot_be_configured_does_not_know_the_request(new_board, request_):
    kind = pack(request_, 1)[1]
    bench = BoardBench(new_board).greet()
    assert is_error(bench.ask(request_), ErrorCode.UNKNOWN_KIND, kind)
    [(_, answer)] = bench.receive(encode(bytes((2, kind, 9, 0, 99, 99))))  # its length is not looked at
    assert is_error(answer, ErrorCode.UNKNOWN_KIND, kind)


@pytest.mark.parametrize("kind", [13, 14])
def test_there_is_no_part_nine(bench, kind):
    body = bytes([PARTS]) + bytes(16 if kind == 14 else 0)
    [(_, answer)] = bench.receive(encode(bytes((2, kind, 9, 0)) + body))
    assert is_error(answer, ErrorCode.RANGE, 0)
