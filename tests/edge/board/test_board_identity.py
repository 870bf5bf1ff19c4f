"""edge/board/board.py: only the pinned board is driven; another one is shown, and turned off at most."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from edge.board import board_tool
from edge.board.board import Board
from edge.board.sim_clock import SimClock
from edge.core.errors import RequestError
from edge.core.messages import Command
from firmware_protocol.board_block import BoardBlock, BoardKind, decode_block
from firmware_protocol.messages import Capability, ResetCause
from firmware_protocol.virtual_board.board_config import BoardConfig
from tests.support.virtual_board import VirtualBoard, virtual_board

EVERYTHING = Command(heater_duty=1.0, fan_on=True, led=0.5)
VIRTUAL_ID = BoardConfig().board_id


@contextmanager
def host(started: VirtualBoard, pinned: int | None) -> Iterator[tuple[Board, SimClock, list[int]]]:
    pins: list[int] = []
    with (
        closing(SimClock(started.control)) as clock,
        closing(Board(str(started.port), 115200, clock, 1, pinned=pinned, save_pin=pins.append)) as board,
    ):
        yield board, clock, pins


def keys(board: Board) -> list[str]:
    return [event.key for event in board.take_events()]


def on(started: VirtualBoard) -> list[str]:
    pins = started.truth()["pins"]
    return [pin for pin in ("heater_relay", "fan", "led", "valve") if pins[pin]]


def drive(board: Board, clock: SimClock) -> None:
    board.drive(EVERYTHING, False, 30.0)
    board.serve(clock.now() + 15.0)


def test_another_board_is_shown_and_not_driven_until_it_is_accepted(tmp_path: Path) -> None:
    with virtual_board(tmp_path) as started, host(started, pinned=0x7777) as (board, clock, pins):
        board.serve(clock.now() + 3.0)
        assert board.foreign == f"board {VIRTUAL_ID} answers, board {0x7777} is pinned"
        assert not board.link_up and board.has_samples and pins == []
        drive(board, clock)
        assert on(started) == [] and board.serve_until_echo(1.5) is None
        told = "Board 1 is this rig's board from now on (before: 30583). It is driven from the next step on."
        assert board.accept() == (True, told) and pins == [VIRTUAL_ID] and "board.pinned" in keys(board)
        drive(board, clock)
        assert {"heater_relay", "fan", "led"} <= set(on(started))
        assert board.accept() == (False, "Nothing changed: board 1, at the port, is already this rig's.")
        assert pins == [VIRTUAL_ID]


def test_a_stop_reaches_another_board_and_its_release_only_once_accepted(tmp_path: Path) -> None:
    with virtual_board(tmp_path, "--fan-safe-on") as started, host(started, pinned=7) as (board, clock, _):
        board.maintain()  # before the link is up
        board.serve(clock.now() + 3.0)
        assert on(started) == []
        board.emergency_stop()
        board.serve(clock.now() + 3.0)
        assert board.echo is not None and board.echo.trip_cause == "emergency_stop"
        for release in (board.end_maintenance, board.release_stop, board.clear_trip):
            release()
        board.serve(clock.now() + 5.0)
        assert board.echo.stopped
        board.accept()
        board.serve(clock.now() + 5.0)
        assert not board.echo.tripped


@pytest.mark.parametrize(("pinned", "found"), [(None, [VIRTUAL_ID]), (VIRTUAL_ID, [])])
def test_the_first_board_that_answers_is_pinned_and_the_pinned_one_driven(
    tmp_path: Path, pinned: int | None, found: list[int]
) -> None:
    with virtual_board(tmp_path) as started, host(started, pinned) as (board, clock, pins):
        board.serve(clock.now() + 3.0)
        assert pins == found and ("board.pinned" in keys(board)) == bool(found)
        assert board.link_up and not board.foreign
        drive(board, clock)
        assert "heater_relay" in on(started)


def test_a_board_without_a_configuration_is_never_pinned(tmp_path: Path) -> None:
    with virtual_board(tmp_path) as started, host(started, pinned=None) as (board, clock, pins):
        board.serve(clock.now() + 3.0)
        board._pinned = None
        pins.clear()
        board._greet(BoardConfig(board_id=0).hello(1, ResetCause.POWER_ON, 1))
        assert pins == [] and not board.foreign
        board._pinned = 7
        with pytest.raises(RequestError, match="no board that is configured answers at the port"):
            board.accept()
        assert board.foreign and pins == []


class ConfigurableSession:
    """A board that takes a configuration."""

    path = "port"

    def __init__(self, board_id: int) -> None:
        parts = Capability.CONFIGURABLE if board_id != 5 else Capability(0)
        config = BoardConfig(board_id=board_id, capabilities=parts)
        self.hello = config.hello(0, ResetCause.POWER_ON, 1)
        self.bytes = bytes(128) if board_id == 0 else board_tool.encode_block(block(board_id))

    def block(self) -> bytes:
        return self.bytes

    def write_block(self, data: bytes) -> None:
        self.bytes = data
        self.hello = replace(self.hello, board_id=decode_block(data).board_id)


def block(board_id: int, **more: object) -> BoardBlock:
    return replace(BoardBlock(BoardKind.UNO, board_id, pins=(4, 5, 255, 255, 255)), **more)  # type: ignore[arg-type]


def test_setup_gives_a_board_with_the_examples_id_one_of_its_own() -> None:
    sessions = [ConfigurableSession(board_id) for board_id in (1, 1, 77, 0)]
    for session in sessions:
        list(board_tool.give_own_id(session))  # type: ignore[arg-type]
    first, second, *others = [session.hello.board_id for session in sessions]
    assert min(first, second) > 1 and first != second and others == [77, 0]


@pytest.mark.parametrize(("before", "in_file", "after"), [(0, 1, None), (77, 1, 77), (1, 1, 1), (77, 9, 9)])
def test_a_file_with_the_examples_id_leaves_a_board_its_own(
    before: int, in_file: int, after: int | None
) -> None:
    session = ConfigurableSession(before)
    list(board_tool.configure(session, block(in_file, fan_safe_on=False)))  # type: ignore[arg-type]
    assert session.hello.board_id == after if after else session.hello.board_id > 1
