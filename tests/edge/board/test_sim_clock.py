"""The host's clock in lock-step with a virtual board."""

import math
import os
import signal
import socket
import threading
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.board.serial_port import PortGone, SerialPort
from edge.board.sim_clock import START_UTC, BoardProcessGone, SimClock
from edge.core.errors import GreenhouseError
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import Hello, HelloRequest, pack, unpack
from firmware_protocol.virtual_board.lockstep import milliseconds
from tests.support.virtual_board import virtual_board


@dataclass
class LockStepRig:
    board: object
    clock: SimClock
    port: SerialPort


@pytest.fixture
def rig(tmp_path):
    with virtual_board(tmp_path) as board:
        clock, port = SimClock(board.control), SerialPort(str(board.port), 115200)
        yield LockStepRig(board, clock, port)
        port.close()
        clock.close()


@pytest.fixture
def wake():
    reader, writer = os.pipe()
    yield reader, writer
    os.close(reader)
    os.close(writer)


def wait_till(rig, until_s):
    """Read until then; what came."""
    data = b""
    while rig.clock.now() < until_s:
        rig.clock.wait(rig.port, None, until_s)
        data += rig.port.read()
    return data


def test_time_begins_at_0_and_utc_moves_with_it(rig):
    assert rig.clock.now() == 0.0 and rig.clock.utc() == START_UTC
    rig.clock.wait(None, None, 90.0)
    assert rig.clock.now() == 90.0 and rig.clock.utc() == START_UTC + 90.0


def test_a_time_that_has_passed_or_is_no_number_does_not_move_it(rig):
    rig.clock.wait(None, None, 5.0)
    for until_s in (5.0, 4.0, -math.inf):
        rig.clock.wait(None, None, until_s)
        assert rig.clock.now() == 5.0


def test_a_time_between_two_milliseconds_is_reached(rig):
    for until_s in (0.1 + 0.2, 32.010000000000005, 33.0000005, 40.0001):
        rig.clock.wait(None, None, until_s)
        assert until_s <= rig.clock.now() <= until_s + 0.001


@given(st.floats(0.0, 1e9))
def test_the_board_never_stops_short_of_a_time(time_s):
    time_ms = milliseconds(time_s)
    assert time_ms / 1000 >= time_s
    assert time_ms <= time_s * 1000 + 2


def test_it_returns_when_the_board_has_sent_something_with_all_of_it(rig):
    rig.clock.wait(rig.port, None, 60.0)
    assert rig.clock.now() < 60.0
    assert FrameDecoder().feed(rig.port.read())


def test_bytes_not_yet_read_hold_time(rig):
    rig.clock.wait(rig.port, None, 60.0)
    before = rig.clock.now()
    rig.clock.wait(rig.port, None, 60.0)
    assert rig.clock.now() == before
    rig.port.read()
    rig.clock.wait(rig.port, None, 60.0)
    assert rig.clock.now() > before


def test_an_answer_comes_some_milliseconds_after_the_request(rig):
    wait_till(rig, 2.05)
    rig.port.write(encode(pack(HelloRequest(5), 1)))
    data = wait_till(rig, 2.06)
    header, hello = unpack(FrameDecoder().feed(data)[0])
    assert isinstance(hello, Hello) and hello.session == 5 and header.ack == 1


def test_a_readable_wake_descriptor_holds_time(rig, wake):
    reader, writer = wake
    os.write(writer, b"x")
    rig.clock.wait(rig.port, reader, 60.0)
    assert rig.clock.now() == 0.0
    os.read(reader, 1)
    rig.clock.wait(None, reader, 60.0)
    assert rig.clock.now() == 60.0


def test_a_wake_up_is_noticed_while_waiting(rig, wake):
    reader, writer = wake
    timer = threading.Timer(0.2, os.write, (writer, b"x"))
    timer.start()
    rig.clock.wait(None, reader, 1e8)
    timer.join()
    assert 0.0 < rig.clock.now() < 1e8


def test_a_wake_up_is_noticed_while_pacing(rig, wake):
    reader, writer = wake
    clock = SimClock(rig.board.control, speed=0.001)
    timer = threading.Timer(0.1, os.write, (writer, b"x"))
    timer.start()
    clock.wait(None, reader, 1.0)  # 1000 s of real time, if it did not wake
    timer.join()
    clock.close()
    assert clock.now() < 1.0


def test_speed_bounds_how_fast_time_goes(rig):
    import time

    clock = SimClock(rig.board.control, speed=50.0)
    started = time.monotonic()
    clock.wait(None, None, 10.0)
    clock.close()
    assert time.monotonic() - started >= 10.0 / 50.0 - 0.01


def test_the_clock_continues_where_the_board_is(rig):
    rig.clock.wait(None, None, 12.5)
    other = SimClock(rig.board.control)
    assert other.now() == 12.5
    other.close()


def greeted(rig, session):
    """Open the port anew and greet; the sessions of the hellos that come."""
    rig.port = SerialPort(str(rig.board.port), 115200)
    rig.port.write(encode(pack(HelloRequest(session), 1)))
    rig.clock.wait(rig.port, None, rig.clock.now() + 0.05)
    messages = [unpack(payload)[1] for payload in FrameDecoder().feed(rig.port.read())]
    return [message.session for message in messages if isinstance(message, Hello)]


def test_a_port_opened_again_counts_from_0(rig):
    wait_till(rig, 5.0)
    rig.port.write(encode(pack(HelloRequest(5), 1)))
    rig.clock.wait(rig.port, None, 6.0)  # its answer is never read
    for session in range(6, 16):
        rig.port.close()
        try:
            sessions = greeted(rig, session)
        except PortGone:  # opened before the board saw it closed: the next try finds a port of its own
            rig.port.close()
            rig.clock.wait(None, None, rig.clock.now() + 0.05)
            sessions = greeted(rig, session)
        assert sessions == [session]


def test_an_unplugged_port_ends_the_wait_and_fails_when_read(rig):
    wait_till(rig, 2.0)
    rig.clock.inject(name="unplug", start_s=2.3)
    data = b""
    with pytest.raises(PortGone):
        while rig.clock.now() < 60.0:
            rig.clock.wait(rig.port, None, 60.0)
            data += rig.port.read()
    assert rig.clock.now() == 2.3
    rig.clock.wait(rig.port, None, 60.0)
    assert rig.clock.now() == 2.3  # still nothing to wait for on a dead port
    rig.clock.wait(None, None, 60.0)
    assert rig.clock.now() == 60.0


def test_faults_and_truth_go_through_it(rig):
    rig.clock.inject(name="mute", duration_s=5)
    assert rig.clock.truth()["faults"] == ["mute"]
    with pytest.raises(GreenhouseError, match="nearest known: 'mute'"):
        rig.clock.inject(name="muted")
    rig.clock.wait(None, None, 6.0)
    assert rig.clock.truth()["faults"] == []


def test_a_killed_board_is_named(rig):
    rig.board.process.send_signal(signal.SIGKILL)
    rig.board.process.wait()
    with pytest.raises(BoardProcessGone, match=str(rig.board.control)):
        rig.clock.wait(None, None, 60.0)
    with pytest.raises(PortGone):
        rig.port.read()


def test_no_board_is_named(tmp_path):
    with pytest.raises(BoardProcessGone, match=r"no virtual board listens at .*control"):
        SimClock(tmp_path / "control")


def test_a_board_in_real_time_is_refused(tmp_path):
    with virtual_board(tmp_path, "--real-time") as board, pytest.raises(GreenhouseError, match="real time"):
        SimClock(board.control)


def test_quit_ends_the_board(rig):
    rig.clock.quit()
    assert rig.board.process.wait(timeout=10) == 0


def test_an_answer_that_an_interrupt_left_unread_is_not_taken_for_the_next(rig, monkeypatch):
    send = rig.clock._socket

    class Interrupted:
        def readline(self):
            raise KeyboardInterrupt

        def close(self):
            answers.close()

    answers = rig.clock._answers
    monkeypatch.setattr(rig.clock, "_answers", Interrupted())
    with pytest.raises(KeyboardInterrupt):
        rig.clock.wait(None, None, 7.0)
    monkeypatch.undo()
    assert isinstance(send, socket.socket)
    assert rig.clock.truth()["pins"]["heater_relay"] is False  # the truth, not the answer to 7.0
    rig.clock.wait(None, None, 8.0)
    assert rig.clock.now() == 8.0
