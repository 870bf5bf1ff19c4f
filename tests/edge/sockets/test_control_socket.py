"""The control socket, and a stop on the disk for a daemon that does not answer."""

import contextlib
import errno
import gc
import json
import os
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from edge.core.errors import ConfigError, RequestError
from edge.sockets.client import request
from edge.sockets.control_socket import CLIENTS_MAX, LINE_MAX, ControlSocket
from edge.sockets.stop_file import FILE, NOBODY, StopFile

pytestmark = pytest.mark.slow


def echo(message):
    return {"ok": True, "heard": dict(message)}


def post(message, answered):
    answered({"ok": True, "posted": dict(message)})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "control.sock"


@pytest.fixture
def server(path):
    own = ControlSocket(path, echo, post)
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


@pytest.fixture
def uncollected() -> Iterator[None]:
    """No garbage of other tests is collected in the depth of a recursion, where it cannot be reported."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.parametrize(
    "line",
    [
        b'{"do": "emergency_stop", "state": "ON"}',
        b'{"do": "Emergency-Stop", "by": "Ann"}',
        b'{"do": "stop"}',
        b'{"do": "ask", "words": "STOP!"}',
        b'{"do": "set_mode", "mode": "emergency stop"}',
        b"stop",
        b"EMERGENCY STOP",
    ],
)
def test_a_stop_in_other_words_is_one(server, path, line):
    [answer] = exchange(path, line + b"\n")
    assert answer["posted"] in ({"do": "emergency_stop"}, {"do": "emergency_stop", "by": "Ann"})


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"null", b"1", b'"x"', b"{'do': 1}", b'{"a": NaN}', b'{"a": -Infinity}', b"\xff\xfe",
     b"[" * 5000, b'{"a": ' + b"9" * 5000 + b"}"],
)  # fmt: skip
def test_what_is_no_json_object_gets_an_error_line_and_the_connection_goes_on(
    server, path, line, uncollected
):
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
    with contextlib.closing(ControlSocket(path, lambda message: {"ok": 1 / message["divisor"]}, post)):
        answer = request(path, {"divisor": 0})
        assert answer == {"ok": False, "error": "internal error: ZeroDivisionError('division by zero')"}
        assert request(path, {"divisor": 1}) == {"ok": 1.0}


def test_a_client_that_does_not_read_holds_up_itself_alone(path):
    asked = []
    answer = {"ok": True, "text": "x" * 60000}
    own = ControlSocket(path, lambda message: asked.append(message) or answer, post)
    with contextlib.closing(own), connect(path) as deaf:
        deaf.settimeout(0.05)
        with pytest.raises(TimeoutError):  # nobody takes what it sends any more
            while True:
                deaf.sendall(b"{}\n" * 1000)
        count = len(asked)
        assert count < 100
        for _ in range(3):
            assert request(path, {"do": "status"})["ok"] is True
        assert len(asked) == count + 3


def test_clients_take_turns(path):
    order = []
    own = ControlSocket(path, lambda message: order.append(message["who"]) or {"ok": True}, post)
    with contextlib.closing(own), connect(path) as greedy:
        greedy.sendall(b'{"who": "greedy"}\n' * 3000)
        request(path, {"who": "modest"})
        assert order.index("modest") < 3000
        answered = b""
        while answered.count(b"\n") < 3000:
            answered += greedy.recv(65536)


def test_a_client_that_goes_away_before_its_answer_is_forgotten(server, path):
    for _ in range(50):
        connection = connect(path)
        connection.sendall(b'{"do": "status"}\n{"do"')
        connection.close()
    assert request(path, {"do": "status"})["ok"] is True


def test_a_new_client_always_gets_in_and_the_longest_idle_one_gives_up_its_place(server, path):
    guests = [connect(path) for _ in range(CLIENTS_MAX)]
    for guest in guests[1:]:  # the first one stays silent
        guest.sendall(b"{}\n")
        guest.recv(1000)
    assert request(path, {"do": "status"})["ok"] is True
    assert answers(guests[0]) == [{"ok": False, "error": "another client needs the place"}]
    guests[1].sendall(b"{}\n")  # and only that one
    assert b"heard" in guests[1].recv(1000)
    for guest in guests[1:]:
        guest.close()


def test_thousands_of_connections_do_not_lock_out_a_stop(server, path):
    program = (
        "import socket, sys\n"
        "guests = []\n"
        "for number in range(1500):\n"
        "    guest = socket.socket(socket.AF_UNIX); guest.connect(sys.argv[1])\n"
        "    if number % 2: guest.send(b'{\"do\": ')\n"
        "    guests = [guest, *guests[:500]]\n"
    )
    flood = [subprocess.Popen([sys.executable, "-c", program, str(path)]) for _ in range(2)]
    waits = []
    while any(each.poll() is None for each in flood):
        begun = time.monotonic()
        assert request(path, {"do": "emergency_stop"})["ok"] is True
        waits.append(time.monotonic() - begun)
    assert [each.returncode for each in flood] == [0, 0]
    assert len(waits) > 5
    assert max(waits) < 10.0  # a guest that sends half a line may stay for 30 s


def test_a_stop_is_answered_while_another_request_takes_its_time(path):
    asked, release = threading.Event(), threading.Event()

    def hang(message):
        asked.set()
        release.wait(20)
        return {"ok": True}

    own = ControlSocket(path, hang, post)
    try:
        guests = [connect(path) for _ in range(CLIENTS_MAX - 1)]
        for guest in guests:
            guest.sendall(b'{"do": "why"}\n' * 100)
        assert asked.wait(20)
        for what in ("emergency_stop", "maintenance"):
            assert request(path, {"do": what}, timeout_s=1.0) == {"ok": True, "posted": {"do": what}}
        release.set()
        for guest in guests:
            guest.close()
    finally:
        release.set()
        own.close()


def test_a_place_is_found_even_where_every_client_waits_for_its_answer(path):
    release = threading.Event()
    own = ControlSocket(path, lambda message: release.wait(20) and {"ok": True}, post)
    try:
        guests = [connect(path) for _ in range(CLIENTS_MAX)]
        for guest in guests:
            guest.sendall(b"{}\n")
        assert request(path, {"do": "emergency_stop"}, timeout_s=1.0)["ok"] is True
        release.set()
        for guest in guests:
            guest.close()
    finally:
        release.set()
        own.close()


def test_clients_that_flood_with_stops_do_not_lock_out_others(server, path):
    ended = threading.Event()

    def flood():
        while not ended.is_set():
            with contextlib.suppress(OSError), connect(path) as guest:
                guest.sendall(b'{"do": "emergency_stop"}\n' * 50)
                guest.recv(10)

    threads = [threading.Thread(target=flood) for _ in range(8)]
    for thread in threads:
        thread.start()
    try:
        for what in ("status", "emergency_stop", "maintenance") * 3:
            assert request(path, {"do": what}, timeout_s=5.0)["ok"] is True
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def test_an_idle_client_is_told_and_closed(path, monkeypatch):
    monkeypatch.setattr("edge.sockets.control_socket.IDLE_MAX_S", 0.2)
    monkeypatch.setattr("edge.sockets.control_socket.SWEEP_S", 0.05)
    with contextlib.closing(ControlSocket(path, echo, post)):
        guest = connect(path)
        ended = time.monotonic() + 20
        with contextlib.suppress(OSError):  # a byte now and then is no request
            while time.monotonic() < ended:
                guest.sendall(b" ")
                time.sleep(0.02)
        assert time.monotonic() < ended
        assert answers(guest) == [{"ok": False, "error": "idle for 0.2 s"}]


def test_a_client_is_told_that_no_answer_came_and_the_request_is_not_asked_later(path, monkeypatch):
    monkeypatch.setattr("edge.sockets.control_socket.ANSWER_MAX_S", 0.2)
    monkeypatch.setattr("edge.sockets.control_socket.SWEEP_S", 0.05)
    release, asked = threading.Event(), []

    def slow(message):
        asked.append(message["n"])
        release.wait(20)
        return {"ok": True}

    own = ControlSocket(path, slow, lambda message, answered: None)
    try:
        for number, what in enumerate(("why", "set_mode", "emergency_stop")):
            answer = request(path, {"do": what, "n": number})
            assert answer == {"ok": False, "error": "no answer within 0.2 s"}
        release.set()
        assert request(path, {"do": "status", "n": 3})["ok"] is True
        assert asked == [0, 3]
    finally:
        release.set()
        own.close()


def test_only_owner_and_group_may_connect(server, path):
    mode = path.stat().st_mode
    assert stat.S_ISSOCK(mode)
    assert stat.S_IMODE(mode) == 0o660


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_another_user_is_kept_out():
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "control.sock"
        own = ControlSocket(path, echo, post)
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
    with contextlib.closing(ControlSocket(path, echo, post)):
        assert request(path, {"do": "status"})["ok"] is True


def test_a_live_daemon_is_not_pushed_aside(server, path):
    with pytest.raises(ConfigError, match="another daemon listens there"):
        ControlSocket(path, echo, post)
    assert request(path, {"do": "status"})["ok"] is True


def test_a_file_that_is_no_socket_is_left_alone(path):
    path.write_text("precious")
    with pytest.raises(ConfigError, match="is not a socket"):
        ControlSocket(path, echo, post)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("place", ["missing/control.sock", "x" * 200])
def test_a_place_that_can_hold_no_socket_is_named(tmp_path, place):
    with pytest.raises(ConfigError, match=r"control_socket\.path: .*" + place):
        ControlSocket(tmp_path / place, echo, post)


def test_closing_takes_the_file_away_and_ends_the_thread(path):
    before = threading.active_count()
    own = ControlSocket(path, echo, post)
    guest = connect(path)
    own.close()
    assert not path.exists()
    assert threading.active_count() == before
    assert answers(guest) == []


def test_closing_leaves_the_file_of_a_successor(path):
    first = ControlSocket(path, echo, post)
    path.unlink()
    second = ControlSocket(path, echo, post)
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

    own = ControlSocket(path, hang, post)
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


def test_a_stop_names_its_author_until_it_is_taken_away(tmp_path: Path) -> None:
    stop = StopFile(tmp_path / "stops")
    assert stop.author() is None
    stop.leave("Ann (page)")
    assert stop.author() == "Ann (page)"
    stop.leave("Bo\x1b[2J")
    assert stop.author() == "Bo [2J"
    stop.take_away()
    assert stop.author() is None
    stop.take_away()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b'{"by": ""}', b"{}", b"x" * 5000])
def test_a_stop_that_cannot_be_read_is_one(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    assert StopFile(tmp_path).author() == NOBODY


def test_a_fifo_in_its_place_is_one_too_and_holds_up_nobody(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / FILE)
    stop_file = StopFile(tmp_path)
    assert stop_file.author() == NOBODY
    stop_file.leave("Ann")
    assert stop_file.author() == "Ann"


def test_a_folder_in_its_place_is_one_too(tmp_path: Path) -> None:
    (tmp_path / FILE).mkdir()
    assert StopFile(tmp_path).author() == NOBODY


def test_one_that_cannot_be_left_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "stops").write_text("a file")
    with pytest.raises(OSError, match="stops"):
        StopFile(tmp_path / "stops").leave("Ann")
