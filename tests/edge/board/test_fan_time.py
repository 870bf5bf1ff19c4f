"""edge/board/board.py: the fan for a part of a step, on a board that times it and on one that does not."""

import pytest
from test_board_stops import host, serve

from edge.core.messages import Command
from firmware_protocol.messages import Capability
from tests.support.virtual_board import CORES, virtual_board

STEP_S = 12.0


def fan_is_on(started) -> bool:
    return bool(started.truth()["pins"]["fan"])


@pytest.mark.parametrize("core", CORES)
@pytest.mark.parametrize("is_timed", [True, False])
def test_the_fan_is_on_for_its_share_and_then_off(tmp_path, core, is_timed):
    with virtual_board(tmp_path, "--core", CORES[core]) as started, host(started) as board:
        serve(board, 3.0)
        assert Capability.FAN_TIME in Capability(board.hello.capabilities)
        if not is_timed:
            object.__setattr__(board.hello, "capabilities", board.hello.capabilities & ~Capability.FAN_TIME)
        board.drive(Command(0.5, True, fan_share=7.0 / STEP_S), False, STEP_S)
        echo = board.serve_until_echo(1.0)
        assert echo.fan == pytest.approx(7.0 / STEP_S)
        serve(board, 6.5)
        assert fan_is_on(started)
        serve(board, 1.0)
        assert not fan_is_on(started)
        assert board.echo.heater_duty == 0.5  # the rest of the command goes on
        serve(board, 3.0)
        assert not fan_is_on(started)


def test_a_host_that_falls_silent_leaves_a_fan_that_ends_in_time(tmp_path):
    with virtual_board(tmp_path, "--fan-safe-on") as started, host(started) as board:
        serve(board, 3.0)
        board.drive(Command(0.0, True, fan_share=0.5), False, 8.0)
        assert board.serve_until_echo(1.0)
        board.clock.wait(None, None, board.clock.now() + 3.5)
        assert fan_is_on(started)
        board.clock.wait(None, None, board.clock.now() + 1.5)
        assert not fan_is_on(started)
        board.clock.wait(None, None, board.clock.now() + 9.0)
        assert fan_is_on(started)  # its lease is over: the board's own state


def test_a_whole_step_has_no_end(tmp_path):
    with virtual_board(tmp_path) as started, host(started) as board:
        serve(board, 3.0)
        board.drive(Command(0.0, True), False, 6.0)
        serve(board, 12.0)
        assert fan_is_on(started)
