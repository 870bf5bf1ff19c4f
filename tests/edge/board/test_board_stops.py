"""edge/board/board.py: stops and releases reach the board whatever the link does; its pins are the judge."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from edge.board.board import Board
from edge.board.sim_clock import SimClock
from edge.core.messages import Command
from firmware_protocol.messages import ReleaseStop
from tests.support.virtual_board import CORES, VirtualBoard, virtual_board

EVERYTHING = Command(heater_duty=1.0, fan_on=True, led=0.5, valve_pulse_s=0.0)
STOPS = {"emergency_stop": ("emergency_stop", "release_stop"), "maintenance": ("maintain", "end_maintenance")}
stops = pytest.mark.parametrize("cause", STOPS)
cores = pytest.mark.parametrize("core", CORES)


@contextmanager
def host(started: VirtualBoard, session: int = 1) -> Iterator[Board]:
    """A daemon's end of the line that has greeted and has a sample."""
    with (
        closing(SimClock(started.control)) as clock,
        closing(Board(str(started.port), 115200, clock, session)) as board,
    ):
        board.clock = clock  # type: ignore[attr-defined]
        yield board


def serve(board: Board, for_s: float) -> None:
    board.serve(board.clock.now() + for_s)  # type: ignore[attr-defined]


def drive_everything(board: Board) -> None:
    serve(board, 3.0)
    board.drive(EVERYTHING, False, 100.0)
    assert board.serve_until_echo(1.5) is not None


def is_still(started: VirtualBoard) -> bool:
    pins = started.truth()["pins"]
    return not (pins["heater_relay"] or pins["fan"] or pins["led"] or pins["valve"])


def moved_since(started: VirtualBoard, since_s: float) -> list[str]:
    return [pin for pin, at_s in started.truth()["last_on_s"].items() if at_s is not None and at_s > since_s]


def rig(tmp_path: Path, core: str = "python") -> object:
    return virtual_board(tmp_path, "--core", CORES[core], "--fan-safe-on")


@cores
@stops
def test_a_stop_holds_when_the_host_falls_silent_or_the_board_resets(tmp_path, core, cause):
    stop, release = STOPS[cause]
    with rig(tmp_path, core) as started:
        with host(started) as board:
            drive_everything(board)
            getattr(board, stop)()
            assert board.serve_until_answered(1.5)
            assert is_still(started) and board.echo.trip_cause == cause and board.echo.stopped
            stopped_s = started.truth()["time_s"]
        started.ask(advance_to_s=stopped_s + 60.0)  # nobody there: every lease ends
        started.inject(name="reset", cause="power_on")
        started.ask(advance_to_s=stopped_s + 120.0)
        assert moved_since(started, stopped_s) == []
        with host(started, session=2) as board:  # a host that knows of nothing, and asks for everything
            serve(board, 3.0)
            board.drive(EVERYTHING, False, 100.0)
            serve(board, 20.0)
            assert moved_since(started, stopped_s) == []
            getattr(board, release)()
            assert board.serve_until_answered(1.5)
            assert not board.echo.tripped and board.echo.fan_on


@stops
def test_a_stop_without_a_link_is_the_first_that_the_board_hears(tmp_path, cause):
    with rig(tmp_path) as started, host(started) as board:
        drive_everything(board)
        started.inject(name="unplug", duration_s=20.0)
        serve(board, 5.0)
        getattr(board, STOPS[cause][0])()
        assert not board.serve_until_answered(1.5)
        board.drive(Command(), True, 100.0)
        serve(board, 25.0)
        assert board.echo.trip_cause == cause and is_still(started)


def test_a_stop_goes_to_every_board_that_comes_up(tmp_path):
    with rig(tmp_path) as started, host(started) as board:
        drive_everything(board)
        board.emergency_stop()
        assert board.serve_until_answered(1.5)
        board._link.request(ReleaseStop(), board.clock.now())  # as if its store had been exchanged
        serve(board, 1.0)
        assert not board.echo.tripped
        started.inject(name="reset", cause="external")
        serve(board, 5.0)
        assert board.echo.trip_cause == "emergency_stop"


def test_both_stops_and_one_release_are_all_obeyed(tmp_path):
    with rig(tmp_path) as started, host(started) as board:
        drive_everything(board)
        board.clear_trip()
        board.maintain()
        board.emergency_stop()
        assert board.serve_until_answered(3.0)
        board.release_stop()
        assert board.serve_until_answered(1.5)
        assert board.echo.trip_cause == "maintenance" and board.in_maintenance
        board.end_maintenance()
        assert board.serve_until_answered(1.5)
        assert not board.echo.tripped and not board.in_maintenance


def test_a_release_that_a_stop_overtook_is_obeyed_after_it(tmp_path):
    with rig(tmp_path) as started, host(started) as board:
        drive_everything(board)
        board.maintain()
        assert board.serve_until_answered(1.5)
        board.end_maintenance()
        board.emergency_stop()  # gives up the request before it
        assert board.serve_until_answered(3.0)
        assert board.echo.trip_cause == "emergency_stop"
        board.release_stop()
        assert board.serve_until_answered(1.5)
        assert not board.echo.tripped


def test_a_trip_that_stands_cools_with_the_fan_only_after_the_release(tmp_path):
    with rig(tmp_path) as started, host(started) as board:
        drive_everything(board)
        board.emergency_stop()
        assert board.serve_until_answered(1.5)
        started.inject(name="sensor_value", value=50.0, duration_s=10.0)
        serve(board, 8.0)
        assert is_still(started)
        board.release_stop()
        assert board.serve_until_answered(1.5)
        assert board.echo.trip_cause == "over_temperature" and board.echo.fan_on
