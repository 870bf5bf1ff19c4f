"""Any bytes at all: nothing is obeyed that was not said, and every frame is found again."""

from dataclasses import replace
from itertools import chain, pairwise

import pytest
from board_bench import CONFIG, HEAT, BoardBench, heating
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frame import MAX_ENCODED, cobs_encode, crc16, encode
from firmware_protocol.messages import (
    PROTOCOL_VERSION,
    EmergencyStop,
    ErrorMessage,
    HelloRequest,
    Ping,
    StateEcho,
    pack,
)

COMMAND = encode(pack(HEAT, 1))
PING = encode(pack(Ping(), 77))
FRAMES = [COMMAND, PING, encode(pack(HelloRequest(5), 3)), encode(pack(EmergencyStop(), 4))]
odd_frames = st.builds(
    lambda kind, body: encode(bytes((PROTOCOL_VERSION, kind, 9, 0)) + body),
    st.integers(0, 255),
    st.binary(max_size=48),
)
runs = st.sampled_from([b"\0", b"\0\0", b"\xff" * 60, b"\x01" * MAX_ENCODED + b"\0"])
any_frames = st.binary(min_size=4, max_size=52).map(encode)
streams = st.lists(
    st.one_of(st.binary(max_size=130), runs, st.sampled_from(FRAMES), odd_frames, any_frames), max_size=12
).map(b"".join)


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=700))
def test_arbitrary_bytes_never_heat_an_ungreeted_board(new_board, data):
    bench = BoardBench(new_board).air(25.0)
    bench.receive(data)
    assert not any(pins.heater_relay for pins in bench.run(2000))


@settings(max_examples=150, deadline=None)
@given(stream=streams)
def test_after_any_stream_the_next_frame_is_answered(new_board, stream):
    bench = BoardBench(new_board).greet()
    bench.receive(stream + b"\0")
    header, answer = bench.receive(encode(pack(Ping(), 78)))[-1]
    assert header.ack == 78 and isinstance(answer, StateEcho | ErrorMessage)


@settings(max_examples=60, deadline=None)
@given(stream=streams, cuts=st.lists(st.integers(0, 800), max_size=20))
def test_it_does_not_matter_how_the_bytes_are_cut(new_board, stream, cuts):
    whole = BoardBench(new_board).air(25.0)
    expected = whole.receive(stream)
    cut = BoardBench(new_board).air(25.0)
    edges = [0, *sorted(at for at in cuts if at < len(stream)), len(stream)]
    pieces = [cut.receive(stream[a:b]) for a, b in pairwise(edges)]
    assert list(chain.from_iterable(pieces)) == expected


def test_a_single_flipped_bit_is_never_obeyed(new_board):
    for at in range(len(COMMAND) - 1):
        for bit in range(8):
            bench = BoardBench(new_board).greet().air(25.0)
            bench.receive(COMMAND[:at] + bytes([COMMAND[at] ^ 1 << bit]) + COMMAND[at + 1 :] + b"\0")
            state = bench.state()
            assert (state.heater_steps, state.led_pct, state.lease_left_s) == (0, 0, 0)


def test_no_part_of_a_command_is_obeyed(new_board):
    bench = BoardBench(new_board).greet().air(25.0)
    for cut in range(1, len(COMMAND) - 1):
        bench.receive(b"\0" + COMMAND[:cut] + b"\0")
        bench.receive(COMMAND[cut:])
    assert bench.state().led_pct == 0
    bench.receive(COMMAND)
    assert bench.state().led_pct == 60


@pytest.mark.parametrize("length", [*range(9), 50, 51, 52, 53, 54, 55, 100, 250, 253, 254, 255, 300])
@pytest.mark.parametrize("fill", [b"\0", b"\x01", b"\xff"])
def test_a_good_crc_of_any_length_is_answered_only_from_header_to_longest_body(new_board, length, fill):
    payload = (bytes((1, 200, 9, 0)) + fill * 300)[:length]
    frame = cobs_encode(payload + crc16(payload).to_bytes(2, "big")) + b"\0"
    assert len(BoardBench(new_board).greet().receive(frame)) == (1 if 4 <= length <= 52 else 0)


@pytest.mark.parametrize("length", [1, 2, 3, 54, 55, 56, 57, 255, 1000])
@pytest.mark.parametrize("fill", [1, 2, 56, 255])
def test_a_run_without_an_end_is_dropped_to_the_next_zero(new_board, length, fill):
    bench = BoardBench(new_board).greet()
    assert bench.receive(bytes([fill]) * length + PING) == []
    assert [header.ack for header, _ in bench.receive(PING)] == [77]


def test_noise_between_commands_does_not_hold_the_outputs(new_board):
    bench = heating(new_board, replace(HEAT, lease_s=1.0), config=replace(CONFIG, lease_max_s=1.0))
    for k in range(10):
        bench.receive(bytes(range(1, 200)) * k + b"\0")
        bench.run(100)
    assert bench.state().heater_steps == 0
