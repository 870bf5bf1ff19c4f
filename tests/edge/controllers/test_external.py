"""The controller `external` and its socket: a client that proposes, and everything a client can do wrong."""

import json
import math
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st

from edge.controllers.external import External
from edge.core.errors import ConfigError, DataError, RequestError
from edge.core.messages import Command
from edge.sockets.external_proposals import LINE_MAX, ExternalProposals

DEADLINE_S = 5.0
SHORT_S = 0.05


@pytest.fixture
def proposals(tmp_path: Path) -> Iterator[ExternalProposals]:
    made = ExternalProposals(tmp_path / "external.sock")
    yield made
    made.close()


@pytest.fixture
def path(proposals: ExternalProposals, tmp_path: Path) -> Path:
    return tmp_path / "external.sock"


@contextmanager
def connected(path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(DEADLINE_S)
        connection.connect(str(path))
        yield connection


@contextmanager
def answering(path: Path, answer: Callable[[dict], bytes]) -> Iterator[list[dict]]:
    """A client that answers each question so; the questions."""
    asked: list[dict] = []
    with connected(path) as connection:

        def run() -> None:
            with connection.makefile("rb") as lines:
                for line in lines:
                    asked.append(json.loads(line))
                    connection.sendall(answer(asked[-1]))

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield asked
        finally:
            connection.shutdown(socket.SHUT_RDWR)
            thread.join()


def proposing(duty: object = 0.35, fan_on: object = False, **more: object) -> Callable[[dict], bytes]:
    def answer(question: dict) -> bytes:
        return line({"tick": question["tick"], "heater_duty": duty, "fan_on": fan_on, **more})

    return answer


def line(message: object) -> bytes:
    return json.dumps(message).encode() + b"\n"


# what is asked and answered


def test_a_proposal_becomes_the_decision(proposals, path):
    with answering(path, proposing(0.35, True, why={"q": 1.5})):
        decision = External(proposals, DEADLINE_S).decide(context(24.0, 26.0))
    assert decision.command == Command(heater_duty=0.35, fan_on=True)
    assert decision.controller == "external"
    assert decision.why == {"tick": 1, "reference_c": 26.0, "client": {"q": 1.5}}


def test_the_question_says_what_the_daemon_knows(proposals, path):
    controller = External(proposals, DEADLINE_S)
    with answering(path, proposing(0.5)) as asked:
        controller.decide(context(24.0, 26.0, now_s=60.0))
        controller.decide(context(24.5, 26.0, Command(heater_duty=0.2), now_s=120.0))
    first, second = asked
    assert first["tick"] == 1
    assert second["tick"] == 2
    assert (second["time_s"], second["reference_c"], second["temp_air_c"]) == (120.0, 26.0, 24.5)
    assert second["observation"]["error"] == 1.5
    assert second["features"][0] == 0.3  # the same in its scale
    assert second["limits"]["heater_max_duty"] == 1.0
    assert first["previous"] is None
    assert second["previous"] == {"heater_duty": 0.5, "fan_on": False}
    assert second["last_sent"] == {"heater_duty": 0.2, "fan_on": False}  # safety changed it


def test_a_duty_between_two_levels_goes_to_the_nearer(proposals, path):
    with answering(path, proposing(0.33)):
        assert External(proposals, DEADLINE_S).decide(context()).command.heater_duty == 0.35


@pytest.mark.parametrize(
    ("reason", "kept"),
    [
        ("0.25", 0.25),
        ('"%s"' % ("x" * 3000), "too long to keep"),
        ("1e999", "not fit to be kept"),
        ('{"a": [-1e999]}', "not fit to be kept"),
        ('"\\ud800"', "not fit to be kept"),
        ("[" * 400 + "]" * 400, None),
    ],
)
def test_only_reasons_that_the_history_can_take_are_kept(reason, kept):
    told = FakeProposals(json.loads(f'{{"heater_duty": 0.1, "fan_on": false, "why": {reason}}}'))
    why = External(told, DEADLINE_S).decide(context()).why
    json.dumps(why, allow_nan=False, ensure_ascii=False).encode()
    assert kept is None or why["client"] == kept


def test_after_a_switch_nothing_counts_as_proposed(proposals, path):
    controller = External(proposals, DEADLINE_S)
    with answering(path, proposing()) as asked:
        controller.decide(context())
        controller.reset()
        controller.decide(context())
    assert asked[-1]["previous"] is None


# what is refused


@pytest.mark.parametrize("duty", [None, -0.05, 1.05, 7, True, "0.5", [0.5]])
def test_what_is_no_duty_is_refused(proposals, path, duty):
    with answering(path, proposing(duty)), pytest.raises(RequestError, match="heater_duty"):
        External(proposals, DEADLINE_S).decide(context())


@pytest.mark.parametrize("fan_on", [None, 1, "true", 0.0])
def test_what_is_no_state_of_the_relay_is_refused(proposals, path, fan_on):
    with answering(path, proposing(0.5, fan_on)), pytest.raises(RequestError, match="fan_on"):
        External(proposals, DEADLINE_S).decide(context())


class FakeProposals:
    """Proposals without a socket."""

    def __init__(self, answer):
        self.answer = answer

    def ask(self, question, deadline_s):
        return self.answer


json_values = st.none() | st.booleans() | st.floats() | st.text() | st.lists(st.integers())


@given(st.dictionaries(st.sampled_from(["heater_duty", "fan_on", "tick", "why"]), json_values))
def test_whatever_is_answered_becomes_a_command_in_range_or_an_error(answer):
    try:
        command = External(FakeProposals(answer), DEADLINE_S).decide(context()).command
    except RequestError:
        return
    assert 0.0 <= command.heater_duty <= 1.0
    assert command.heater_duty * 20 == pytest.approx(round(command.heater_duty * 20))


def test_an_observation_with_holes_is_not_asked_about():
    class NeverAsked:
        def ask(self, question, deadline_s):
            raise AssertionError

    here = context()
    with pytest.raises(DataError, match="observation"):
        External(NeverAsked(), DEADLINE_S).decide(replace(here, reference=np.array([math.nan])))


# what a client can do wrong


def test_with_nobody_there_it_says_so_at_once(proposals):
    with pytest.raises(RequestError, match="nobody is connected"):
        proposals.ask({"tick": 1}, DEADLINE_S)


def test_a_silent_client_costs_the_deadline_and_no_more(proposals, path):
    with connected(path), pytest.raises(RequestError, match="no answer to tick 1 in time"):
        proposals.ask({"tick": 1}, SHORT_S)


def test_a_late_answer_is_skipped_and_the_right_one_taken(proposals, path):
    late = line({"tick": 1, "heater_duty": 1.0})
    with answering(path, lambda question: late + proposing(0.1)(question)):
        assert proposals.ask({"tick": 2}, DEADLINE_S)["heater_duty"] == 0.1


def test_an_answer_to_another_tick_alone_is_none(proposals, path):
    def other(question: dict) -> bytes:
        return line({"tick": question["tick"] + 1})

    with answering(path, other), pytest.raises(RequestError, match="no answer to tick 1"):
        proposals.ask({"tick": 1}, SHORT_S)


def test_what_came_between_ticks_is_thrown_away(proposals, path):
    with connected(path) as client:
        client.sendall(line({"tick": 1, "heater_duty": 1.0}))  # guessed before it was asked
        with pytest.raises(RequestError, match="no answer to tick 1"):
            proposals.ask({"tick": 1}, SHORT_S)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"nonsense\n", "answer: "),
        (b"[1]\n", "answer: not JSON: not a JSON object"),
        (b'{"tick": NaN}\n', "answer: not JSON: NaN is not JSON"),
        (b"\xff\n", "answer: not JSON: not UTF-8"),
        (b"[" * 10000 + b"\n", "answer: not JSON: nested too deep"),
        (b"x" * (LINE_MAX + 1), "an answer of more than"),
    ],
)
def test_a_client_that_talks_nonsense_is_hung_up_on(proposals, path, answer, reason):
    with answering(path, lambda question: answer):
        with pytest.raises(RequestError, match=reason):
            proposals.ask({"tick": 1}, DEADLINE_S)
        with pytest.raises(RequestError, match="nobody is connected"):
            proposals.ask({"tick": 2}, DEADLINE_S)


def test_a_client_that_drips_bytes_gains_no_time(proposals, path):
    stop = threading.Event()
    with connected(path) as client:

        def drip() -> None:
            while not stop.is_set():
                client.sendall(b"{")
                stop.wait(0.005)

        thread = threading.Thread(target=drip)
        thread.start()
        try:
            with pytest.raises(RequestError, match="no answer to tick 1 in time"):
                proposals.ask({"tick": 1}, 4 * SHORT_S)
        finally:
            stop.set()
            thread.join()


def test_a_client_that_floods_is_hung_up_on(proposals, path):
    with connected(path) as client:
        client.setblocking(False)
        with pytest.raises(BlockingIOError):
            while True:
                client.send(b"x" * 65536)
        with pytest.raises(RequestError, match="nobody is connected"):
            proposals.ask({"tick": 1}, DEADLINE_S)


def test_a_client_that_does_not_read_is_hung_up_on(proposals, path):
    with connected(path), pytest.raises(RequestError, match="does not read"):
        proposals.ask({"tick": 1, "much": "x" * 10_000_000}, SHORT_S)


def test_a_client_that_went_away_leaves_its_place(proposals, path):
    with connected(path):
        assert proposals.wait_for_client(0.0)
    with answering(path, proposing()):
        assert proposals.ask({"tick": 1}, DEADLINE_S)["heater_duty"] == 0.35


def test_a_second_client_is_refused_with_the_reason(proposals, path):
    with answering(path, proposing(0.1)):
        assert proposals.ask({"tick": 1}, DEADLINE_S)["heater_duty"] == 0.1
        with connected(path) as second:
            assert proposals.ask({"tick": 2}, DEADLINE_S)["heater_duty"] == 0.1
            with second.makefile("rb") as lines:
                assert json.loads(lines.readline()) == {"refused": "another client is connected"}
                assert lines.readline() == b""


# the socket


def test_only_owner_and_group_may_connect(proposals, path):
    assert stat.S_IMODE(path.stat().st_mode) == 0o660


def test_a_place_where_somebody_listens_is_refused(proposals, path):
    with pytest.raises(ConfigError, match=r"external\.socket: .* another daemon listens there"):
        ExternalProposals(path)


def test_closing_takes_the_file_away_and_hangs_up(proposals, path):
    with connected(path) as client:
        assert proposals.wait_for_client(0.0)
        proposals.close()
        proposals.close()
        assert client.recv(1) == b""
    assert not path.exists()


def test_waiting_for_a_client_ends_in_time(proposals):
    assert not proposals.wait_for_client(SHORT_S)
