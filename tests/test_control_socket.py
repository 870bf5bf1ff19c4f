import errno
import json
import os
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from edge.control_socket import CLIENTS_MAX, LINE_MAX, ControlSocket, request
from edge.errors import ConfigError, RequestError


def echo(message):
    return {"ok": True, "heard": dict(message)}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "control.sock"


@pytest.fixture
def server(path):
    own = ControlSocket(path, echo)
    yield own
    own.close()


def connect(path):
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(20)
    connection.connect(str(path))
    return connection


def answers(connection):
    """All answers up to the end of the connection."""
    with connection, connection.makefile("rb") as lines:
        return [json.loads(line) for line in lines]


def exchange(path, data):
    connection = connect(path)
    connection.sendall(data)
    connection.shutdown(socket.SHUT_WR)
    return answers(connection)


def test_a_request_is_answered(server, path):
    assert request(path, {"do": "status"}) == {"ok": True, "heard": {"do": "status"}}


def test_several_requests_on_one_connection_are_answered_in_order(server, path):
    lines = b"".join(b'{"n": %d}\n' % number for number in range(100))
    assert [answer["heard"]["n"] for answer in exchange(path, lines)] == list(range(100))


def test_a_request_may_come_byte_by_byte(server, path):
    connection = connect(path)
    for byte in b'{"do": "status"}\n':
        connection.sendall(bytes([byte]))
    connection.shutdown(socket.SHUT_WR)
    assert answers(connection) == [{"ok": True, "heard": {"do": "status"}}]


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"null", b"1", b'"x"', b"{'do': 1}", b'{"a": NaN}', b'{"a": -Infinity}', b"\xff\xfe",
     b"[" * 5000, b'{"a": ' + b"9" * 5000 + b"}"],
)  # fmt: skip
def test_what_is_no_json_object_gets_an_error_line_and_the_connection_goes_on(server, path, line):
    bad, good = exchange(path, line + b'\n{"do": "status"}\n')
    assert bad["ok"] is False
    assert bad["error"].startswith("request: ")
    assert good["ok"] is True


@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(data=st.binary(max_size=300))
def test_any_bytes_get_one_answer_a_line(server, path, data):
    assert len(exchange(path, data)) == data.count(b"\n")


def test_a_request_at_the_limit_is_heard_and_one_byte_more_is_refused(server, path):
    line = b'{"a": "' + b"x" * (LINE_MAX - 9) + b'"}'
    assert len(line) == LINE_MAX
    assert exchange(path, line + b"\n")[0]["ok"] is True
    assert "longer than" in exchange(path, line + b" \n")[0]["error"]


def test_an_endless_line_is_cut_off(server, path):
    connection = connect(path)
    with pytest.raises(OSError):
        for _ in range(100):
            connection.sendall(b"x" * LINE_MAX)
    connection.close()
    assert request(path, {"do": "status"})["ok"] is True


def test_silent_and_half_finished_clients_block_nobody(server, path):
    silent, half = connect(path), connect(path)
    half.sendall(b'{"do": ')
    for _ in range(20):
        assert request(path, {"do": "status"})["ok"] is True
    half.sendall(b'"late"}\n')
    half.shutdown(socket.SHUT_WR)
    assert answers(half) == [{"ok": True, "heard": {"do": "late"}}]
    silent.close()


def test_a_bug_behind_one_request_does_not_take_the_others_away(path):
    own = ControlSocket(path, lambda message: {"ok": 1 / message["divisor"]})
    try:
        answer = request(path, {"divisor": 0})
        assert answer == {"ok": False, "error": "internal error: ZeroDivisionError('division by zero')"}
        assert request(path, {"divisor": 1}) == {"ok": 1.0}
    finally:
        own.close()


def test_a_client_that_does_not_read_holds_up_itself_alone(path):
    asked = []
    own = ControlSocket(path, lambda message: asked.append(message) or {"ok": True, "text": "x" * 60000})
    try:
        with connect(path) as deaf:
            deaf.settimeout(0.05)
            with pytest.raises(TimeoutError):  # nobody takes what it sends any more
                while True:
                    deaf.sendall(b"{}\n" * 1000)
            count = len(asked)
            assert count < 100
            for _ in range(3):
                assert request(path, {"do": "status"})["ok"] is True
            assert len(asked) == count + 3
    finally:
        own.close()


def test_clients_take_turns(path):
    order = []
    own = ControlSocket(path, lambda message: order.append(message["who"]) or {"ok": True})
    try:
        with connect(path) as greedy:
            greedy.sendall(b'{"who": "greedy"}\n' * 3000)
            request(path, {"who": "modest"})
            assert order.index("modest") < 3000
            answered = b""
            while answered.count(b"\n") < 3000:
                answered += greedy.recv(65536)
    finally:
        own.close()


def test_a_client_that_goes_away_before_its_answer_is_forgotten(server, path):
    for _ in range(50):
        connection = connect(path)
        connection.sendall(b'{"do": "status"}\n{"do"')
        connection.close()
    assert request(path, {"do": "status"})["ok"] is True


def test_one_client_too_many_is_told_so_and_room_comes_back(server, path):
    guests = [connect(path) for _ in range(CLIENTS_MAX)]
    for guest in guests:  # each is surely accepted once it has its answer
        guest.sendall(b"{}\n")
        guest.recv(1000)
    assert answers(connect(path)) == [{"ok": False, "error": "too many clients"}]
    for guest in guests:
        guest.close()
    deadline = time.monotonic() + 20
    while "heard" not in request(path, {"do": "status"}):
        assert time.monotonic() < deadline


def test_only_owner_and_group_may_connect(server, path):
    mode = path.stat().st_mode
    assert stat.S_ISSOCK(mode)
    assert stat.S_IMODE(mode) == 0o660


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_another_user_is_kept_out():
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "control.sock"
        own = ControlSocket(path, echo)
        child = os.fork()
        if child == 0:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            os._exit(socket.socket(socket.AF_UNIX).connect_ex(str(path)))
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == errno.EACCES
        own.close()


def test_a_stale_file_is_replaced(path):
    program = (
        "import socket,sys,os; s=socket.socket(socket.AF_UNIX); s.bind(sys.argv[1]); s.listen(); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", program, str(path)], check=True)
    assert path.exists()
    own = ControlSocket(path, echo)
    try:
        assert request(path, {"do": "status"})["ok"] is True
    finally:
        own.close()


def test_a_live_daemon_is_not_pushed_aside(server, path):
    with pytest.raises(ConfigError, match="another daemon listens there"):
        ControlSocket(path, echo)
    assert request(path, {"do": "status"})["ok"] is True


def test_a_file_that_is_no_socket_is_left_alone(path):
    path.write_text("precious")
    with pytest.raises(ConfigError, match="is not a socket"):
        ControlSocket(path, echo)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("place", ["missing/control.sock", "x" * 200])
def test_a_place_that_can_hold_no_socket_is_named(tmp_path, place):
    with pytest.raises(ConfigError, match=r"control_socket\.path: .*" + place):
        ControlSocket(tmp_path / place, echo)


def test_closing_takes_the_file_away_and_ends_the_thread(path):
    before = threading.active_count()
    own = ControlSocket(path, echo)
    guest = connect(path)
    own.close()
    assert not path.exists()
    assert threading.active_count() == before
    assert answers(guest) == []


def test_closing_leaves_the_file_of_a_successor(path):
    first = ControlSocket(path, echo)
    path.unlink()
    second = ControlSocket(path, echo)
    first.close()
    assert request(path, {"do": "status"})["ok"] is True
    second.close()


def test_closing_does_not_wait_for_a_loop_that_never_answers(path):
    release = threading.Event()
    asked = threading.Event()

    def hang(message):
        asked.set()
        release.wait(20)
        return {"ok": False}

    own = ControlSocket(path, hang)
    guest = connect(path)
    guest.sendall(b"{}\n")
    assert asked.wait(20)
    own.close(timeout_s=0.01)
    assert not path.exists()
    release.set()
    answers(guest)


def test_without_a_daemon_the_client_says_so(path):
    with pytest.raises(RequestError, match="no daemon listens"):
        request(path, {"do": "status"})


def test_a_daemon_that_hangs_or_leaves_is_told_from_one_that_answers(path):
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    with pytest.raises(RequestError, match=r"did not answer within 0\.05 s"):
        request(path, {"do": "status"}, timeout_s=0.05)
    listener.accept()[0].close()

    def leave():
        connection, _ = listener.accept()
        connection.recv(100)
        connection.close()

    thread = threading.Thread(target=leave)
    thread.start()
    with pytest.raises(RequestError, match="went away"):
        request(path, {"do": "status"})
    thread.join()
    listener.close()
