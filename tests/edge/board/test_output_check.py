"""Outputs driven for a person who looks on: the effect is seen or not, and everything is off afterwards."""

import itertools
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edge.board import output_check
from edge.board.board_session import BoardSession
from edge.board.output_check import CHECKS, OutputRefused, outputs, run_check, suited_check
from edge.board.sim_clock import SimClock
from edge.core.clock import RealClock
from edge.core.errors import RequestError
from firmware_protocol.board_block import NO_PIN, BoardBlock, BoardKind, encode_block
from firmware_protocol.messages import (
    Capability,
    CommandMessage,
    HeaterOffCause,
    Hello,
    Quality,
    ResetCause,
    SensorReport,
    StateEcho,
    TripCause,
)
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_samples import Samples
from tests.support.virtual_board import VirtualBoard, virtual_board

pytest_plugins = ["rig_places"]

QUICK_BOX = "box: {width_m: 0.2, depth_m: 0.2, height_m: 0.2}\nheater: {capacity_j_k: 10, deadtime_s: 0}\n"
ECHO = StateEcho(
    board_ms=0,
    heater_steps=0,
    heater_off_cause=HeaterOffCause.COMMANDED,
    fan_on=False,
    led_pct=0,
    valve_open=False,
    cutoff_open=False,
    tripped=False,
    trip_cause=TripCause.NONE,
    lease_left_s=0.0,
    fan_rpm=None,
)


class ObedientBoard:
    """A session whose board does what it is asked, and whose sensors read what a test says."""

    def __init__(self, airs_c: Iterator[float | None], fan_safe_on: bool = False, **echo: Any) -> None:
        self.hello: Hello = BoardConfig(fan_safe_on=fan_safe_on).hello(0, ResetCause.POWER_ON, 1)
        self.commands: list[CommandMessage] = []
        self.on = False
        self.clock = RealClock()
        self._airs_c = airs_c
        self._echo = replace(ECHO, **echo)

    def state(self) -> StateEcho:
        return self._echo

    def drive(self, command: CommandMessage) -> StateEcho:
        self.commands.append(command)
        self.on = True
        return replace(self._echo, heater_steps=command.heater_steps, fan_on=bool(command.fan_on))

    def turn_off(self) -> None:
        self.on = False

    def report(self) -> SensorReport:
        air_c = next(self._airs_c)
        quality = Quality.FAULT if air_c is None else Quality.GOOD
        return replace(Samples().report(5), temp_air_c=air_c, temp_air_quality=quality)


def effect_of(board: ObedientBoard, name: str) -> bool | None:
    return run_check(board, suited_check(board, name), lambda text: None)  # type: ignore[arg-type]


def test_warmer_air_shows_that_the_heater_works() -> None:
    board = ObedientBoard(itertools.count(20.0, 0.1))
    assert effect_of(board, "heater") is True
    assert not board.on
    assert all(0.0 < command.lease_s <= output_check.LEASE_S for command in board.commands)


def test_the_air_must_stay_warm_for_as_many_samples_as_before() -> None:
    spike = itertools.chain([20.0] * 5, [20.0, 20.0, 23.0, 20.0], itertools.repeat(None))
    with pytest.raises(OutputRefused, match="not good"):
        effect_of(ObedientBoard(spike), "heater")


@pytest.mark.parametrize("air_c", [None, float("nan"), 35.0, 80.0])
def test_hot_or_unknown_air_is_not_heated(air_c: float | None) -> None:
    board = ObedientBoard(itertools.repeat(air_c))
    with pytest.raises(OutputRefused):
        effect_of(board, "heater")
    assert board.commands == []


@pytest.mark.parametrize("air_c", [None, 35.0])
def test_air_that_becomes_hot_or_unknown_ends_the_heat(air_c: float | None) -> None:
    board = ObedientBoard(itertools.chain([34.0] * 7, [air_c]))
    with pytest.raises(OutputRefused):
        effect_of(board, "heater")
    assert len(board.commands) == 3 and not board.on


def test_a_board_that_is_held_is_not_driven() -> None:
    board = ObedientBoard(itertools.repeat(20.0), tripped=True, trip_cause=TripCause.EMERGENCY_STOP)
    with pytest.raises(OutputRefused, match="emergency stop"):
        effect_of(board, "fan")
    assert board.commands == []


def test_a_board_that_obeys_no_fan_is_not_asked_what_turned() -> None:
    class Deaf(ObedientBoard):
        def drive(self, command: CommandMessage) -> StateEcho:
            return replace(super().drive(command), fan_on=not command.fan_on)

    for fan_safe_on in (False, True):
        with pytest.raises(OutputRefused, match="obeys no heater and no fan"):
            effect_of(Deaf(itertools.repeat(20.0), fan_safe_on), "fan")


def test_a_tacho_shows_that_the_fan_turns() -> None:
    assert effect_of(ObedientBoard(itertools.repeat(20.0), fan_rpm=900), "fan") is True


def test_a_fan_that_runs_by_itself_is_turned_off_instead() -> None:
    still = ObedientBoard(itertools.repeat(20.0), fan_safe_on=True, fan_rpm=0)
    assert effect_of(still, "fan") is True
    assert [command.fan_on for command in still.commands] == [0]
    assert "Did the fan stop" in suited_check(still, "fan").question  # type: ignore[arg-type]


def test_the_fan_stands_while_the_heat_arrives() -> None:
    late = itertools.chain([20.0] * 30, itertools.repeat(21.0))
    board = ObedientBoard(late, fan_safe_on=True)
    heater = replace(CHECKS["heater"], seconds=0.2)
    board.report = lambda: (time.sleep(0.01), ObedientBoard.report(board))[1]  # type: ignore[method-assign]
    assert run_check(board, heater, print) is True  # type: ignore[arg-type]
    assert board.commands[0].heater_steps == 20 and board.commands[-1].heater_steps == 0
    assert not any(command.fan_on for command in board.commands)


def test_ctrl_c_turns_off() -> None:
    def airs_c() -> Iterator[float]:
        yield from [20.0] * 7
        raise KeyboardInterrupt

    board = ObedientBoard(airs_c())
    with pytest.raises(KeyboardInterrupt):
        effect_of(board, "heater")
    assert board.commands and not board.on


class ConfiguredBoard:
    """A session that has a block."""

    def __init__(self, block: bytes | None) -> None:
        self.hello = BoardConfig(capabilities=Capability.VALVE).hello(0, ResetCause.POWER_ON, 1)
        self._block = block

    def block(self) -> bytes | None:
        return self._block


def test_the_outputs_are_those_that_the_board_has() -> None:
    block = encode_block(BoardBlock(BoardKind.UNO, 7, pins=(7, 8, NO_PIN, NO_PIN, 3)))
    assert outputs(ConfiguredBoard(block)) == ("heater", "fan", "led")  # type: ignore[arg-type]
    assert outputs(ConfiguredBoard(None)) == ("heater", "fan", "valve")  # type: ignore[arg-type]


def test_a_board_without_a_configuration_names_the_command_that_writes_one() -> None:
    with pytest.raises(RequestError, match="greenhouse board configure FILE"):
        outputs(ConfiguredBoard(b"\xff" * 144))  # type: ignore[arg-type]


# The virtual board, in simulated time unless a fixture says otherwise.


@contextmanager
def session_of(board: VirtualBoard) -> Iterator[BoardSession]:
    """Return a session in lock-step with the board."""
    with closing(SimClock(board.control)) as clock, BoardSession(str(board.port), clock=clock) as session:
        yield session


@pytest.fixture
def quick(folder: Path) -> Iterator[VirtualBoard]:
    """A board in simulated time, in a box that warms within seconds."""
    (folder / "box.yaml").write_text(QUICK_BOX)
    with virtual_board(folder, "--chamber", str(folder / "box.yaml")) as running:
        yield running


def heats(board: VirtualBoard) -> bool:
    return bool(board.truth()["pins"]["heater_relay"])


@pytest.mark.slow
def test_the_light_shows_at_its_sensor_and_the_fan_and_the_valve_at_none(quick: VirtualBoard) -> None:
    with session_of(quick) as session:
        assert outputs(session) == ("heater", "fan", "led", "valve")
        results = {name: run_check(session, CHECKS[name], print) for name in ("led", "fan", "valve")}
        truth = quick.truth()
    assert results == {"led": True, "fan": None, "valve": None}
    assert all(truth["last_on_s"][name] is not None for name in results)
    assert not any(truth["pins"].values())


def inject(board: VirtualBoard, name: str, in_s: float = 0.0, **parameters: float) -> None:
    """Start a fault so many seconds from now."""
    board.inject(name=name, start_s=board.truth()["time_s"] + in_s, **parameters)


@pytest.mark.slow
def test_a_heater_warms_a_small_box(quick: VirtualBoard) -> None:
    with session_of(quick) as session:
        assert run_check(session, CHECKS["heater"], print) is True
        assert not heats(quick)


@pytest.mark.slow
def test_a_dead_heater_has_no_effect(quick: VirtualBoard) -> None:
    inject(quick, "heater_dead")
    with session_of(quick) as session:
        assert run_check(session, CHECKS["heater"], print) is False
        assert not heats(quick)


@pytest.mark.slow
def test_an_unplugged_port_leaves_nothing_driven(board: VirtualBoard) -> None:
    def unplug(text: str) -> None:
        assert heats(board)
        inject(board, "unplug")

    with BoardSession(str(board.port)) as session, pytest.raises(RequestError, match=r"is gone|fell silent"):
        run_check(session, CHECKS["heater"], unplug)
    while heats(board):
        time.sleep(0.1)


@pytest.mark.slow
def test_air_that_grows_hot_while_the_person_thinks_is_noticed(board: VirtualBoard) -> None:
    with BoardSession(str(board.port)) as session:
        session.report()
        inject(board, "sensor_offset", in_s=6.0, offset=14.0)  # to 36 °C
        time.sleep(7.0)  # enough reports of cool air wait in the buffer
        with pytest.raises(OutputRefused, match="checked below 35"):
            run_check(session, CHECKS["heater"], print)
    assert board.truth()["last_on_s"]["heater_relay"] is None


@pytest.mark.slow
def test_without_air_temperature_neither_heater_nor_fan_is_tested(quick: VirtualBoard) -> None:
    inject(quick, "sensor_none")
    with session_of(quick) as session:
        for name in ("heater", "fan"):
            with pytest.raises(OutputRefused, match="not good"):
                run_check(session, CHECKS[name], print)
    assert quick.truth()["last_on_s"]["heater_relay"] is None
