"""The virtual board as a program: its port, its control socket, lock-step, real time, its files."""

import errno
import io
import os
import signal
import socket
import time
from contextlib import redirect_stderr
from pathlib import Path

import pytest
import serial
from line import LineHost

from edge.board.serial_port import SerialPort
from edge.board.sim_clock import SimClock
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.link import BoardReset, LinkLost, LinkUp
from firmware_protocol.messages import (
    Capability,
    EmergencyStop,
    Hello,
    HelloRequest,
    SensorReport,
    pack,
    unpack,
)
from firmware_protocol.virtual_board.__main__ import main
from tests.support.virtual_board import CORES, VirtualBoard, command, virtual_board

pytestmark = pytest.mark.slow

NOISE = [
    {"name": "flip_bits", "rate": 0.01},
    {"name": "drop_bytes", "rate": 0.01},
    {"name": "duplicate_bytes", "rate": 0.01},
    {"name": "garbage", "start_s": 7, "count": 100},
    {"name": "delay", "start_s": 12, "duration_s": 5, "delay_s": 0.3},
    {"name": "sensor_spike", "start_s": 3, "duration_s": 20, "size": 5, "rate": 0.3},
    {"name": "reset", "start_s": 20, "cause": "watchdog"},
    {"name": "unplug", "start_s": 25, "duration_s": 3},
]


def messages(data: bytes) -> list[object]:
    return [unpack(payload)[1] for payload in FrameDecoder().feed(data)]


def end(board: VirtualBoard, number: int) -> int:
    board.process.send_signal(number)
    return board.process.wait(timeout=10)


def refused(directory: Path, *options: str) -> str:
    """Return the message of a board that may not start."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        with redirect_stderr(io.StringIO()) as said:
            assert main(command(directory, *options)[3:]) == 1  # the words after the module's name
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return said.getvalue()


@pytest.mark.parametrize("core", CORES)
def test_a_host_meets_the_board_and_gets_a_report_a_second(tmp_path, core):
    with virtual_board(tmp_path, "--core", CORES[core]) as board, LineHost(board) as host:
        host.serve(10.5)
        assert len(host.seen(LinkUp)) == 1
        times = [report.board_ms for report in host.reports()]
        assert times == list(range(1000, 11000, 1000))
        assert 15 < host.reports()[0].temp_air_c < 27  # a room


@pytest.mark.parametrize("core", CORES)
def test_heat_warms_the_box_and_the_meters_agree(tmp_path, core):
    with virtual_board(tmp_path, "--core", CORES[core]) as board, LineHost(board) as host:
        host.heat()
        host.serve(600)
        truth = board.truth()
        assert truth["pins"]["heater_relay"] and truth["heat_on"]
        assert truth["heat_on_s"] == pytest.approx(truth["heater_pin_on_for_s"])
        assert 590 < truth["heat_on_s"] <= 600
        assert truth["energy"]["heater_in_j"] == pytest.approx(100 * truth["heat_on_s"], rel=0.1)  # 100 W
        assert truth["hottest_air_c"] > host.reports()[0].temp_air_c + 5


@pytest.mark.parametrize("core", CORES)
def test_the_same_seed_and_script_give_the_same_bytes(tmp_path, core):
    runs = []
    for name in ("one", "two"):
        directory = tmp_path / name
        directory.mkdir()
        options = ("--core", CORES[core], "--seed", "7")
        with virtual_board(directory, *options, faults=NOISE) as board, LineHost(board) as host:
            host.heat()
            host.serve(60)
            runs.append((host.received, repr(host.events), board.truth()))
    assert runs[0] == runs[1]
    assert len(runs[0][0]) > 1000


def test_both_cores_give_the_same_bytes(tmp_path):
    runs = []
    for core in CORES:
        directory = tmp_path / core
        directory.mkdir()
        with virtual_board(directory, "--core", CORES[core], faults=NOISE) as board, LineHost(board) as host:
            host.heat()
            host.serve(60)
            runs.append(host.received)
    assert runs[0] == runs[1]


def test_another_seed_gives_other_bytes(tmp_path):
    runs = []
    for seed in ("1", "2"):
        with virtual_board(tmp_path, "--seed", seed) as board, LineHost(board) as host:
            host.serve(20)
            runs.append(host.received)
    assert runs[0] != runs[1]


def test_nothing_moves_until_told(tmp_path):
    with virtual_board(tmp_path) as board:
        assert board.truth()["time_s"] == board.truth()["time_s"] == 0.0
        assert board.ask(advance_to_s=1.5)["time_s"] == 1.5
        assert board.truth()["time_s"] == 1.5
        assert board.ask(advance_to_s=1.0)["time_s"] == 1.5  # time does not go back


def test_bytes_the_host_claims_but_never_wrote_are_an_error(tmp_path):
    with virtual_board(tmp_path) as board:
        answer = board.ask(advance_to_s=1, host_bytes=3)
        assert "written 3 bytes, 0 have come" in answer["error"]
        assert board.truth()["time_s"] == 0.0


@pytest.fixture(scope="module")
def untouched_board(tmp_path_factory):
    with virtual_board(tmp_path_factory.mktemp("board")) as board:
        yield board


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"{}", "one of"),
        (b"[]", "a JSON object"),
        (b"advance", "not JSON"),
        (b"[" * 50_000, "not JSON"),
        (b'{"advance": 1}', "nearest known: 'advance_to_s'"),
        (b'{"advance_to_s": 1, "host_byte": 0}', "nearest known: 'host_bytes'"),
        (b'{"advance_to_s": 1, "truth": true}', "one of"),
        (b'{"advance_to_s": -1}', "not a number in"),
        (b'{"advance_to_s": NaN}', "not a number in"),
        (b'{"advance_to_s": Infinity}', "not a number in"),
        (b'{"advance_to_s": null}', "not a number in"),
        (b'{"advance_to_s": true}', "not a number in"),
        (b'{"fault": {"name": "unplugg"}}', "nearest known: 'unplug'"),
        (b'{"fault": {"name": "mute", "duration": 1}}', "nearest known: 'duration_s'"),
        (b'{"fault": null}', "a fault is a mapping"),
    ],
)
def test_a_wrong_request_is_answered_with_what_is_wrong(untouched_board, line, says):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(untouched_board.control))
        connection.sendall(line + b"\n")
        answer = connection.makefile().readline()
    assert "error" in answer and says in answer.replace('\\"', '"')
    assert untouched_board.truth()["time_s"] == 0.0


def test_a_client_that_hangs_up_in_the_middle_is_no_harm(tmp_path):
    with virtual_board(tmp_path) as board:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(board.control))
            connection.sendall(b'{"advance_to_s": 1')
        assert board.truth()["time_s"] == 0.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(tmp_path, number):
    with virtual_board(tmp_path) as board:
        assert board.port.is_symlink() and board.control.is_socket()
        assert end(board, number) == 0
        assert not os.path.lexists(board.port) and not board.control.exists()


def test_quit_ends_it_cleanly(tmp_path):
    with virtual_board(tmp_path) as board:
        board.ask(quit=True)
        assert board.process.wait(timeout=10) == 0
        assert list(tmp_path.iterdir()) == []


def test_what_a_killed_board_left_is_replaced(tmp_path):
    with virtual_board(tmp_path) as board:
        end(board, signal.SIGKILL)
    assert (tmp_path / "port").is_symlink() and (tmp_path / "control").is_socket()
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        host.serve(3)
        assert host.up


def test_the_paths_of_a_live_board_are_refused_and_it_lives_on(tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    state = tmp_path / "state"
    with virtual_board(tmp_path, "--state", str(state)) as board:
        before = state.read_bytes()
        assert "in use by a running board" in refused(tmp_path, "--state", str(state))
        assert "in use by a running board" in refused(other, "--link", str(board.port))
        assert state.read_bytes() == before
        with LineHost(board) as host:
            host.serve(3)
            assert host.up


def test_a_file_of_somebody_else_is_not_taken_away(tmp_path):
    (tmp_path / "port").write_text("mine")
    assert "no board has made" in refused(tmp_path)
    assert (tmp_path / "port").read_text() == "mine"


def test_a_wrong_script_state_or_chamber_is_refused_with_its_place(tmp_path):
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("- {name: mute}\n- {name: flip_bit}\n")
    assert "wrong.yaml: fault 2: unknown fault 'flip_bit'; nearest known: 'flip_bits'" in refused(
        tmp_path, "--faults", str(wrong)
    )
    assert "wrong.yaml: no state of a virtual board" in refused(tmp_path, "--state", str(wrong))
    wrong.write_text("[" * 5_000)
    for option in ("--faults", "--state", "--chamber"):
        assert "wrong.yaml: " in refused(tmp_path, option, str(wrong))
    wrong.write_text("heater: {pover_w: 100}\n")
    assert "pover_w" in refused(tmp_path, "--chamber", str(wrong))
    assert not os.path.lexists(tmp_path / "port") and not (tmp_path / "control").exists()


@pytest.mark.parametrize("core", CORES)
def test_a_trip_and_the_boot_count_survive_the_process(tmp_path, core):
    options = ("--core", CORES[core], "--state", str(tmp_path / "state"))
    with virtual_board(tmp_path, *options) as board, LineHost(board) as host:
        host.serve(3)
        host._link.request(EmergencyStop(), host.clock.now())
        host.serve(4)
        end(board, signal.SIGKILL)
    with virtual_board(tmp_path, *options) as board, LineHost(board) as host:
        host.heat()
        host.serve(10)
        assert host.seen(LinkUp)[0].hello.boot_count == 2
        assert board.truth()["boot_count"] == 2
        assert board.truth()["heater_pin_last_on_s"] is None


def test_a_board_has_the_parts_it_is_said_to_have(tmp_path):
    options = ("--without", "co2", "--with", "fan_tacho", "--with", "heater_cutoff")
    with virtual_board(tmp_path, *options) as board, LineHost(board) as host:
        host.serve(5)
        parts = host.seen(LinkUp)[0].hello.capabilities
        assert Capability.CO2 not in parts
        assert Capability.FAN_TACHO | Capability.HEATER_CUTOFF | Capability.LIGHT in parts
        report = host.reports()[-1]
        assert report.co2_ppm is None and report.light is not None
        assert board.truth()["pins"]["cutoff_open"]


def test_an_unplugged_port_fails_at_the_host_and_returns_as_another(tmp_path):
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        host.serve(5)
        board.inject(name="unplug", duration_s=4)
        assert not os.path.lexists(board.port)
        host.serve(8)
        assert len(host.errors) == 1 and not host.up
        assert not board.truth()["plugged"]
        host.serve(15)
        assert host.up and len(host.errors) == 1
        assert os.path.lexists(board.port)
        assert len(host.seen(LinkLost)) == 1
        assert len(host.seen(BoardReset)) == 1  # at power on; the plug is not the board's supply


def test_reading_and_writing_an_unplugged_port_gives_an_input_output_error(tmp_path):
    with virtual_board(tmp_path) as board:
        descriptor = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        board.inject(name="unplug")
        with pytest.raises(OSError) as caught:
            os.write(descriptor, b"x")
        assert caught.value.errno == errno.EIO
        os.close(descriptor)


def test_a_port_closed_and_opened_again_works_on(tmp_path):
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        for turn in range(1, 6):
            host.serve(host.clock.now() + 5)
            assert host.up
            host.close_port()
            host.events += host._link.disconnect(host.clock.now())
            assert len(host.seen(LinkUp)) == turn


def test_a_host_may_end_and_another_one_start(tmp_path):
    with virtual_board(tmp_path) as board:
        for _ in range(3):
            with LineHost(board) as host:
                host.serve(host.clock.now() + 5)
                assert host.up and not host.errors


def test_the_last_bytes_before_a_close_still_reach_the_board(tmp_path):
    with virtual_board(tmp_path) as board:
        port = SerialPort(str(board.port), 115200)
        port.write(encode(pack(HelloRequest(1), 1)))
        port.close()
        board.ask(advance_to_s=1)
        assert board.truth()["bytes"]["to_board"] == len(encode(pack(HelloRequest(1), 1)))


def test_a_host_that_never_reads_does_not_stop_the_board(tmp_path):
    with virtual_board(tmp_path) as board:
        clock, port = SimClock(board.control), SerialPort(str(board.port), 115200)
        clock.request({"advance_to_s": 1200, "host_bytes": 0})
        truth = board.truth()
        assert truth["time_s"] == 1200 and truth["bytes"]["lost_at_port"] > 16_000
        port.close()
        clock.close()


def test_in_real_time_the_board_reports_by_itself(tmp_path):
    with virtual_board(tmp_path, "--real-time") as board:
        assert board.ask(advance_to_s=100) == {"error": "this board runs in real time"}
        with serial.Serial(str(board.port), 115200, timeout=5) as port:
            port.write(encode(pack(HelloRequest(9), 1)))
            received = b""
            deadline = time.monotonic() + 20
            while time.monotonic() < deadline and len(messages(received)) < 4:
                received += port.read(1)
        kinds = {type(message) for message in messages(received)}
        assert {Hello, SensorReport} <= kinds


def test_in_real_time_a_port_returns_too(tmp_path):
    with virtual_board(tmp_path, "--real-time") as board:
        board.inject(name="unplug", duration_s=0.2)
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline and not board.truth()["plugged"]:
            time.sleep(0.02)
        with serial.Serial(str(board.port), 115200, timeout=10) as port:
            assert port.read(1) != b""
