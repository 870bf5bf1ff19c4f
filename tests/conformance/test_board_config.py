"""A configuration that hello cannot tell: the C board takes the nearest, Python's refuses to be made."""

import ctypes
from dataclasses import fields

import pytest
from board_bench import HEAT, BoardBench

from firmware_protocol.errors import LocalProtocolError
from firmware_protocol.messages import Capability, Hello, StateEcho
from firmware_protocol.virtual_board.board_config import BoardConfig
from tests.support.c_core import BLANK, CBoardCore, CConfig

NUMBERS = ["lease_max_s", "temp_trip_c", "valve_pulse_max_s", "pwm_window_s", "report_period_s"]
LOWEST = dict(zip(NUMBERS, (0.1, 0.0, 0.0, 1.0, 0.1), strict=True))
HIGHEST = dict(zip(NUMBERS, (60.0, 100.0, 60.0, 600.0, 60.0), strict=True))
SCALE = dict(zip(NUMBERS, (1000, 100, 10, 10, 1000), strict=True))


class RawBoard(CBoardCore):
    """The C board with a configuration of raw integers that no BoardConfig can hold."""

    def __init__(self, raw: dict[str, int], persistent: bytes, reset_cause: int, boot_count: int) -> None:
        super().__init__(BoardConfig(), b"", 0, 0)
        self.transmit()
        config = CConfig(capabilities=0x3FF, **raw)
        self._library.gh_board_init(self._board, ctypes.byref(config), BLANK, reset_cause, boot_count)
        self._drain()


def hello_of(raw: dict[str, int], reset_cause: int = 0) -> Hello:
    [(_, hello)] = BoardBench(RawBoard, raw, reset_cause=reset_cause).listen()
    assert isinstance(hello, Hello)
    return hello


def told(hello: Hello) -> dict[str, float]:
    return {name: getattr(hello, name) for name in NUMBERS}


def test_a_configuration_of_zeros_and_one_of_the_largest_numbers_are_taken_as_the_nearest():
    largest = dict.fromkeys(NUMBERS, 0x7FFF) | {"lease_max_s": 0xFFFF, "report_period_s": 0xFFFF}
    assert told(hello_of(dict.fromkeys(NUMBERS, 0))) == LOWEST
    assert told(hello_of(largest)) == HIGHEST
    assert hello_of({"temp_trip_c": -1}).temp_trip_c == 0.0


@pytest.mark.parametrize("name", NUMBERS)
def test_the_ends_of_a_range_are_kept_and_one_step_beyond_is_not(name):
    for end, beyond in ((LOWEST[name], -1), (HIGHEST[name], 1)):
        raw = round(end * SCALE[name])
        assert getattr(hello_of({name: raw}), name) == end
        if raw + beyond >= 0:
            assert getattr(hello_of({name: raw + beyond}), name) == end
        assert getattr(hello_of({name: raw - beyond}), name) == (raw - beyond) / SCALE[name]


def test_a_board_configured_with_zeros_runs_and_hardly_heats():
    bench = BoardBench(RawBoard, dict.fromkeys(NUMBERS, 0) | {"temp_trip_c": 4500}).greet().air(25.0)
    answer = bench.ask(HEAT)
    assert isinstance(answer, StateEcho) and answer.lease_left_s == 0.1
    assert not any(pins.heater_relay for pins in bench.run(5000)[1:])


def test_an_unknown_reset_cause_is_told_as_unknown():
    assert [hello_of({}, cause).reset_cause for cause in (5, 6, 255)] == [5, 5, 5]


def test_python_refuses_what_hello_cannot_tell():
    assert set(NUMBERS) < {field.name for field in fields(BoardConfig)}
    for name in NUMBERS:
        for value in (LOWEST[name] - 0.1, HIGHEST[name] + 0.1):
            with pytest.raises(LocalProtocolError):
                BoardConfig(capabilities=Capability(0), **{name: value})
