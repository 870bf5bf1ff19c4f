import json
import random
import sqlite3
from contextlib import closing
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.mqtt import drain
from edge.mqtt.drain import BATCH_ROWS, REFUSED_PAUSE_S, Drain
from edge.mqtt.telemetry import WINDOW_RESERVE, Telemetry
from tests.support.broker import KEEPS_SESSIONS, Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ROOT, ControlLoop, MemoryOutbox, settings

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

HISTORY = f"{ROOT}/history"


class SilentClient:
    """Takes messages and leaves the answers to the test."""

    def __init__(self, first_mid: int = 1) -> None:
        self.next_mid = first_mid
        self.sent: list[tuple[int, str]] = []

    def publish(self, topic, payload, qos):
        assert qos == 1
        mid, self.next_mid = self.next_mid, self.next_mid % 65535 + 1
        self.sent.append((mid, payload))
        return SimpleNamespace(mid=mid)

    def seqs(self) -> list[int]:
        return [json.loads(payload)["seq"] for _, payload in self.sent]


class DrainClock:
    def __init__(self) -> None:
        self.time_s = 100.0

    def __call__(self) -> float:
        return self.time_s


def make(count, first_mid=1):
    outbox, client, clock = MemoryOutbox(count), SilentClient(first_mid), DrainClock()
    return outbox, client, clock, Drain(outbox, client, clock)


def test_no_more_than_the_window_is_in_flight():
    _, client, _, own = make(10)
    own.window = 3
    assert own.step() is True
    assert client.seqs() == [1, 2, 3]
    own.note_answer(1, "")
    own.step()
    assert client.seqs() == [1, 2, 3, 4]


def test_nothing_is_forgotten_before_it_is_answered():
    outbox, _, _, own = make(3)
    own.step()
    for mid in (1, 2):
        own.note_answer(mid, "")
        own.step()
    assert outbox.depth() == 3
    own.note_answer(3, "")
    assert own.step() is False
    assert outbox.acknowledged == [1, 2, 3]
    assert outbox.depth() == 0


def test_answers_in_any_order_keep_the_order_of_rows():
    outbox, client, _, own = make(BATCH_ROWS + 5)
    random.seed(1)
    while own.step():
        mids = [mid for mid, _ in client.sent]
        for mid in random.sample(mids, len(mids)):
            own.note_answer(mid, "")
    assert client.seqs() == list(range(1, BATCH_ROWS + 6))
    assert outbox.acknowledged == list(range(1, BATCH_ROWS + 6))


def test_a_refused_row_stays_and_is_tried_again_after_a_pause():
    outbox, client, clock, own = make(3)
    own.step()
    own.note_answer(1, "")
    own.note_answer(2, "Not authorized")
    own.note_answer(3, "")
    assert own.step() is False
    assert own.refusal == "Not authorized"
    assert list(outbox.rows) == [2]
    clock.time_s += REFUSED_PAUSE_S - 0.001
    assert own.step() is False
    clock.time_s += 0.001
    assert own.step() is True
    assert client.seqs() == [1, 2, 3, 2]
    own.note_answer(4, "")
    own.step()
    assert (own.refusal, outbox.depth()) == ("", 0)


def test_the_answer_to_somebody_elses_message_is_not_taken_for_ours():
    outbox, _, _, own = make(1, first_mid=7)
    own.note_answer(7, "")  # the same id, one round of ids ago
    assert own.step() is True
    assert own.step() is True
    assert outbox.depth() == 1


def test_an_acknowledgement_the_database_did_not_take_is_given_again():
    outbox, client, _, own = make(2)
    own.step()
    own.note_answer(1, "")
    own.note_answer(2, "")
    take = outbox.acknowledge

    def locked(ids):
        raise sqlite3.OperationalError("database is locked")

    outbox.acknowledge = locked
    with pytest.raises(sqlite3.OperationalError):
        own.step()
    outbox.acknowledge = take
    assert own.step() is False
    assert (outbox.acknowledged, client.seqs()) == ([1, 2], [1, 2])


@given(
    count=st.integers(0, 40),
    window=st.integers(1, 50),
    refusals=st.sets(st.integers(1, 80)),
    seed=st.integers(0, 99),
)
def test_every_row_arrives_whatever_is_refused_and_in_whatever_order_answers_come(
    count, window, refusals, seed
):
    outbox, client, clock, own = make(count, first_mid=65500)
    own.window = window
    order = random.Random(seed)
    taken, answered = [], 0
    for _ in range(1000):
        own.step()
        assert len(client.sent) - answered <= window
        waiting = client.sent[answered:]
        for mid, payload in order.sample(waiting, len(waiting)):
            answered += 1
            refused = answered in refusals
            own.note_answer(mid, "quota exceeded" if refused else "")
            if not refused:
                taken.append(json.loads(payload)["seq"])
        clock.time_s += REFUSED_PAUSE_S
    assert sorted(taken) == list(range(1, count + 1))
    assert outbox.depth() == 0


def draining(broker, outbox):
    return closing(Telemetry(settings(broker.port), ControlLoop().ask, ControlLoop().post, lambda: outbox))


def heard(listener):
    return [row["seq"] for row in listener.objects(HISTORY)]


def without_repeats(numbers):
    return list(dict.fromkeys(numbers))


@needs_mosquitto
def test_what_gathered_while_the_broker_was_away_arrives_in_order(tmp_path, quick_reconnect):
    outbox = MemoryOutbox(2000)
    broker = Broker(tmp_path)
    with draining(broker, outbox) as own:
        wait_for(own.faults)
        with broker, Listener(broker.port, HISTORY) as listener:
            wait_for(lambda: outbox.depth() == 0)
            wait_for(lambda: heard(listener)[-1:] == [2000])
            # The first rows may have passed before the listener was there.
            numbers = heard(listener)
            assert numbers == list(range(numbers[0], 2001))


@needs_mosquitto
def test_no_more_messages_are_under_way_than_the_broker_takes(tmp_path, quick_reconnect):
    outbox = MemoryOutbox(300)
    with (
        Broker(tmp_path, "allow_anonymous true\nmax_inflight_messages 20") as broker,
        draining(broker, outbox) as own,
    ):
        wait_for(lambda: outbox.depth() == 0)
        assert own._drain.window == 20 - WINDOW_RESERVE


@needs_mosquitto
def test_a_restart_of_the_broker_loses_nothing(tmp_path, quick_reconnect, monkeypatch):
    monkeypatch.setattr(drain, "BATCH_ROWS", 50)
    outbox = MemoryOutbox(3000)
    with (
        Broker(tmp_path, KEEPS_SESSIONS) as broker,
        Listener(broker.port, HISTORY) as listener,
        draining(broker, outbox),
    ):
        for part in (500, 1500):
            wait_for(lambda part=part: len(outbox.acknowledged) >= part)
            broker.stop()
            broker.start()
        wait_for(lambda: outbox.depth() == 0)
        wait_for(lambda: len(set(heard(listener))) == 3000)
        assert without_repeats(heard(listener)) == list(range(1, 3001))


@needs_mosquitto
def test_what_a_killed_broker_lost_is_a_gap_that_a_resend_fills(tmp_path, quick_reconnect, monkeypatch):
    monkeypatch.setattr(drain, "BATCH_ROWS", 50)
    outbox = MemoryOutbox(3000)
    with Broker(tmp_path) as broker, Listener(broker.port, HISTORY) as listener, draining(broker, outbox):
        for part in (500, 1500):
            wait_for(lambda part=part: len(outbox.acknowledged) >= part)
            broker.kill()
            broker.start()
        wait_for(lambda: outbox.depth() == 0)
        assert set(outbox.acknowledged) == set(range(1, 3001))
        listener.wait_until_subscribed()
        outbox.resend(3000, 3000)  # the end, for a listener that was back too late
        wait_for(lambda: heard(listener)[-1:] == [3000])
        assert without_repeats(heard(listener)) == sorted(set(heard(listener)))
        for missing in set(range(1, 3001)) - set(heard(listener)):
            outbox.resend(missing, missing)
        wait_for(lambda: set(heard(listener)) == set(range(1, 3001)))


@needs_mosquitto
def test_rows_a_broker_may_not_take_stay(tmp_path, quick_reconnect):
    access = tmp_path / "acl"
    access.write_text("topic readwrite other/#\ntopic write greenhouse/rig-1/availability\n")
    outbox = MemoryOutbox(5)
    anyone = f"allow_anonymous true\nacl_file {access}"
    with Broker(tmp_path, anyone) as broker, draining(broker, outbox) as own:
        wait_for(lambda: "the broker refuses: Not authorized" in str(own.faults()))
        assert outbox.depth() == 5
