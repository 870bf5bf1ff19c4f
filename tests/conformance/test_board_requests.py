"""Greeting, numbers, duplicates and every refusal."""

from dataclasses import replace

import pytest
from board_bench import CONFIG, HEAT, IDLE, BoardBench, heating, is_error

from firmware_protocol.frame import encode
from firmware_protocol.messages import (
    PROTOCOL_VERSION,
    Capability,
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    ErrorCode,
    Hello,
    HelloRequest,
    Maintenance,
    Ping,
    ReleaseStop,
    SensorReport,
    StateEcho,
    pack,
)

COMMAND, CLEAR_TRIP, PING, EMERGENCY_STOP, HELLO_REQUEST = 4, 6, 7, 9, 1
BODY_LENGTH = {COMMAND: 7, CLEAR_TRIP: 0, PING: 0, EMERGENCY_STOP: 0, 10: 0, 11: 0, 12: 0, HELLO_REQUEST: 4}
REQUESTS = [HEAT, ClearTrip(), Ping(), EmergencyStop(), Maintenance(), ReleaseStop(), EndMaintenance()]
FROM_BOARD = [2, 3, 5, 8, 16, 18, 19]


def payload(kind: int, body: bytes = b"", seq: int = 1, version: int = PROTOCOL_VERSION) -> bytes:
    return bytes((version, kind, seq, 0)) + body


def command_body(**changed: int) -> bytes:
    raw = {"heater": 20, "fan": 1, "led": 60, "valve": 0, "cutoff": 0, "lease": 10_000} | changed
    return bytes(list(raw.values())[:5]) + raw["lease"].to_bytes(2, "little")


def test_the_first_word_is_an_unasked_hello_with_the_configuration(new_board):
    [(header, hello)] = BoardBench(new_board, reset_cause=2, boot_count=77).listen()
    assert (header.seq, header.ack) == (1, 0)
    assert hello == CONFIG.hello(session=0, reset_cause=2, boot_count=77)


def test_hello_answers_a_request_with_its_session(new_board):
    assert BoardBench(new_board).ask(HelloRequest(session=0xDEADBEEF)).session == 0xDEADBEEF


@pytest.mark.parametrize("request_", REQUESTS)
def test_nothing_is_obeyed_before_the_greeting(new_board, request_):
    bench = BoardBench(new_board).air(25.0)
    kind = pack(request_, 1)[1]
    assert is_error(bench.ask(request_), ErrorCode.NOT_GREETED, kind)
    pins = bench.run(3000)[-1]
    assert not pins.heater_relay and pins.led == 0 and not bench.greet().state().tripped


def test_a_reset_board_does_not_go_on_where_it_was(new_board):
    bench = heating(new_board)
    again = BoardBench(new_board, persistent=bench.board.persistent()).air(25.0)
    assert is_error(again.ask(replace(HEAT, led_pct=1)), ErrorCode.NOT_GREETED, COMMAND)


@pytest.mark.parametrize("kind", FROM_BOARD)
def test_a_looped_back_line_is_not_answered(new_board, kind):
    assert BoardBench(new_board).greet().receive(encode(payload(kind, seq=9))) == []


def test_everything_a_board_says_is_ignored_by_a_board(new_board):
    bench = BoardBench(new_board).greet()
    bench.run(3000)
    bench.listen()
    spoken = [encode(pack(message, header.seq)) for header, message in bench.heard]
    assert {type(m) for _, m in bench.heard} == {Hello, StateEcho, SensorReport}
    assert bench.receive(b"".join(spoken)) == []


def test_a_request_without_a_number_is_not_answered(new_board):
    assert BoardBench(new_board).greet().receive(encode(pack(Ping(), 0))) == []


@pytest.mark.parametrize("version", [0, 1, 3, 255])
@pytest.mark.parametrize("kind", [PING, HELLO_REQUEST, COMMAND, 2, 200])
def test_another_version_is_told_ours(new_board, version, kind):
    [(header, answer)] = BoardBench(new_board).receive(encode(payload(kind, seq=5, version=version)))
    assert header.ack == 5 and is_error(answer, ErrorCode.VERSION, PROTOCOL_VERSION)


def test_a_command_of_another_version_is_not_obeyed(new_board):
    bench = BoardBench(new_board).greet().air(25.0)
    bench.receive(encode(payload(COMMAND, command_body(), version=1)))
    assert bench.state().heater_steps == 0


@pytest.mark.parametrize("kind", [0, 13, 127, 255])
def test_an_unknown_kind_is_named(new_board, kind):
    [(_, answer)] = BoardBench(new_board).greet().receive(encode(payload(kind)))
    assert is_error(answer, ErrorCode.UNKNOWN_KIND, kind)


@pytest.mark.parametrize("kind", BODY_LENGTH)
def test_every_wrong_length_is_named_and_not_obeyed(new_board, kind):
    bench = BoardBench(new_board).greet().air(25.0)
    for length in set(range(49)) - {BODY_LENGTH[kind]}:
        [(_, answer)] = bench.receive(encode(payload(kind, bytes(length), seq=length % 255 + 1)))
        assert is_error(answer, ErrorCode.LENGTH, length)
    assert not bench.state().tripped


@pytest.mark.parametrize(
    ("field", "name", "last_good", "first_bad"),
    [
        (0, "heater", 20, 21),
        (0, "heater", 0, 255),
        (2, "led", 100, 101),
        (4, "cutoff", 1, 2),
        (5, "lease", 60_000, 60_001),
        (5, "lease", 0, 65_535),
    ],
)
def test_a_field_out_of_range_spoils_the_whole_command(new_board, field, name, last_good, first_bad):
    bench = BoardBench(new_board).greet().air(25.0)
    [(_, answer)] = bench.receive(encode(payload(COMMAND, command_body(**{name: first_bad}), seq=200)))
    assert is_error(answer, ErrorCode.RANGE, field)
    state = bench.state()
    assert (state.heater_steps, state.led_pct, state.lease_left_s) == (0, 0, 0)
    [(_, answer)] = bench.receive(encode(payload(COMMAND, command_body(**{name: last_good}), seq=201)))
    assert isinstance(answer, StateEcho)


@pytest.mark.parametrize(
    ("lacking", "field", "wanted"),
    [
        (Capability.LED, 2, {"led_pct": 1}),
        (Capability.VALVE, 3, {"valve_pulse_s": 0.1}),
        (Capability.HEATER_CUTOFF, 4, {"cutoff_open": True}),
    ],
)
def test_an_actuator_that_is_not_there_may_only_be_off(new_board, lacking, field, wanted):
    config = replace(CONFIG, capabilities=CONFIG.capabilities & ~lacking)
    bench = BoardBench(new_board, config).greet().air(25.0)
    assert is_error(bench.ask(replace(IDLE, heater_steps=5, **wanted)), ErrorCode.NO_ACTUATOR, field)
    assert bench.state().heater_steps == 0
    assert bench.ask(replace(IDLE, heater_steps=5)).heater_steps == 5
    assert lacking is not Capability.HEATER_CUTOFF or not bench.step().cutoff_open


def test_a_duplicate_is_answered_again_but_does_not_extend_the_lease(new_board):
    command = replace(HEAT, lease_s=2.0)
    bench = heating(new_board, command)
    first = bench.heard[-1][1]
    bench.run(1500)
    assert bench.ask(command, seq=bench.seq) == first
    bench.run(500)
    assert bench.state().heater_steps == 0


def test_a_duplicate_gives_no_second_pulse(new_board):
    pulse = replace(IDLE, valve_pulse_s=1.0)
    bench = heating(new_board, pulse)
    assert bench.run(900)[-1].valve
    bench.ask(pulse, seq=bench.seq)
    bench.step(100)
    assert not bench.pins.valve
    bench.ask(pulse, seq=bench.seq)
    assert not bench.step(1).valve


def test_a_refusal_is_remembered_with_its_number(new_board):
    bench = BoardBench(new_board).greet().air(25.0)
    bench.ask(EmergencyStop())
    assert is_error(bench.ask(HEAT, seq=99), ErrorCode.TRIPPED, 2)
    bench.ask(HEAT, seq=99)
    assert isinstance(bench.ask(IDLE, seq=100), StateEcho)


def test_a_greeting_forgets_the_last_number(new_board):
    bench = heating(new_board)
    seq = bench.seq
    bench.ask(HelloRequest(session=8), seq=seq)  # never a duplicate itself
    assert bench.ask(IDLE, seq=seq).heater_steps == 0


def test_numbers_go_round_without_a_false_duplicate(new_board):
    bench = BoardBench(new_board).greet().air(25.0)
    for k in range(600):
        assert bench.ask(replace(IDLE, led_pct=k % 100)).led_pct == k % 100


def test_the_board_numbers_its_frames_from_1_to_255(new_board):
    bench = BoardBench(new_board)
    numbers = [header.seq for header, _ in bench.listen()]
    for _ in range(300):
        numbers += [header.seq for header, _ in bench.receive(encode(pack(Ping(), 1)))]
    assert numbers == [k % 255 + 1 for k in range(301)]


def test_reports_come_from_boot_on_greeted_or_not(new_board):
    bench = BoardBench(new_board)
    bench.run(5000)
    reports = [m for _, m in bench.listen() if isinstance(m, SensorReport)]
    assert [report.board_ms for report in reports] == [1000, 2000, 3000, 4000, 5000]


def test_a_late_step_gives_one_report_and_keeps_the_beat(new_board):
    bench = BoardBench(new_board)
    for after_ms in (3450, 549, 1, 900):
        bench.step(after_ms)
    reports = [m.board_ms for _, m in bench.listen() if isinstance(m, SensorReport)]
    assert reports == [3450, 4000]


def test_every_hello_is_followed_by_the_state_unasked(new_board):
    bench = BoardBench(new_board)
    bench.step(100)
    for _ in range(3):  # after the second nothing has changed
        bench.greet()
        bench.step(100)
        [(header, state)] = bench.listen()
        assert isinstance(state, StateEcho) and header.ack == 0
        bench.step(100)
        assert bench.listen() == []


def test_a_change_of_cause_is_told_unasked_once(new_board):
    bench = BoardBench(new_board)
    bench.step(100)
    bench.greet()
    bench.run(500)
    bench.ask(CommandMessage(3, True, 0, 0.0, False, 0.3))
    bench.run(1000, air=None)
    bench.listen()
    told = [m.heater_off_cause.name for h, m in bench.heard if isinstance(m, StateEcho) and not h.ack]
    assert told == ["NOT_GREETED", "LEASE_EXPIRED", "LEASE_EXPIRED"]
