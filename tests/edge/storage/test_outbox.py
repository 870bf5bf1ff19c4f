"""Messages that wait for the broker."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from history_records import HandClock, History, eventful_tick, store, tick

from edge.core.errors import RequestError
from edge.formats.tick_json import event_json, tick_json
from edge.storage import Outbox, OutboxMessage, Storage


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with closing(Outbox(path, "greenhouse/g1")) as outbox:
        yield outbox


def contents(messages: list[OutboxMessage]) -> list[tuple[str, int, object, int]]:
    """Topic, number of the tick, number of the event, whether it is sent again."""
    bodies = [json.loads(message.payload) for message in messages]
    return [
        (message.topic, body["seq"], body.get("number"), body["is_resend"])
        for message, body in zip(messages, bodies, strict=True)
    ]


def test_a_tick_waits_after_its_events_and_in_order(path: Path, outbox: Outbox) -> None:
    store(path, tick(1), eventful_tick(2), tick(3))
    assert contents(outbox.pending(10)) == [
        ("greenhouse/g1/history/tick", 1, None, 0),
        ("greenhouse/g1/history/event", 2, 0, 0),
        ("greenhouse/g1/history/event", 2, 1, 0),
        ("greenhouse/g1/history/tick", 2, None, 0),
        ("greenhouse/g1/history/tick", 3, None, 0),
    ]


def test_a_payload_is_the_tick_and_says_from_which_history(path: Path, outbox: Outbox) -> None:
    record = tick(1)
    store(path, record)
    (message,) = outbox.pending(10)
    with closing(sqlite3.connect(path)) as connection:
        (history_id,) = connection.execute("SELECT id FROM history").fetchone()
    assert json.loads(message.payload) == {"history_id": history_id, "is_resend": 0, **tick_json(record)}


def test_an_events_payload_is_the_event(path: Path, outbox: Outbox) -> None:
    record = eventful_tick(1)
    store(path, record)
    body = json.loads(outbox.pending(1)[0].payload)
    assert body.pop("history_id")
    assert body == {"seq": 1, "number": 0, "is_resend": 0, **event_json(record.events[0])}


def test_what_is_not_acknowledged_comes_again(path: Path, outbox: Outbox) -> None:
    store(path, tick(1), tick(2), tick(3))
    first = outbox.pending(2)
    assert outbox.pending(2) == first
    outbox.acknowledge([first[1].id])
    assert [seq for _, seq, _, _ in contents(outbox.pending(10))] == [1, 3]
    assert outbox.depth() == 2


def test_an_acknowledgement_survives_closing(path: Path, outbox: Outbox) -> None:
    store(path, tick(1), tick(2))
    outbox.acknowledge([message.id for message in outbox.pending(1)])
    outbox.close()
    assert [seq for _, seq, _, _ in contents(outbox.pending(10))] == [2]


@pytest.mark.parametrize("ids", [[], [999], [-1]])
def test_acknowledging_what_does_not_wait_changes_nothing(path: Path, outbox: Outbox, ids: list[int]) -> None:
    store(path, tick(1))
    outbox.pending(1)
    outbox.acknowledge(ids)
    assert outbox.depth() == 1


def test_an_id_is_never_given_to_a_second_message(path: Path, outbox: Outbox) -> None:
    store(path, tick(1))
    old = [message.id for message in outbox.pending(10)]
    outbox.acknowledge(old)
    store(path, tick(2))
    outbox.acknowledge(old)  # a late second acknowledgement
    assert [seq for _, seq, _, _ in contents(outbox.pending(10))] == [2]


@pytest.mark.parametrize(
    ("first", "last", "expected"), [(2, 2, [2]), (2, 3, [2, 3]), (0, 99, [1, 2, 3]), (3, 2, []), (4, 9, [])]
)
def test_a_stretch_is_sent_again_and_says_so(
    path: Path, outbox: Outbox, first: int, last: int, expected: list[int]
) -> None:
    store(path, tick(1), tick(2), tick(3))
    outbox.acknowledge([message.id for message in outbox.pending(10)])
    assert outbox.resend(first, last) == len(expected)
    assert contents(outbox.pending(10)) == [("greenhouse/g1/history/tick", seq, None, 1) for seq in expected]


@pytest.mark.parametrize("sent", [True, False], ids=["sent before", "still waiting"])
def test_the_same_stretch_fifty_times_waits_once(path: Path, outbox: Outbox, sent: bool) -> None:
    store(path, tick(1), eventful_tick(2), tick(3))
    if sent:
        outbox.acknowledge([message.id for message in outbox.pending(10)])
    # 0 would mean that the rig does not have them: what waits from an earlier request is counted.
    assert [outbox.resend(2, 3) for _ in range(50)] == [4] * 50
    assert outbox.depth() == (4 if sent else 5)


def test_a_new_tick_does_not_wait_for_what_is_sent_again(path: Path, outbox: Outbox) -> None:
    store(path, *(tick(seq) for seq in range(1, 20)))
    outbox.acknowledge([message.id for message in outbox.pending(100)])
    outbox.resend(1, 19)
    store(path, tick(20), tick(21))
    assert [seq for _, seq, _, _ in contents(outbox.pending(3))] == [20, 21, 1]
    assert len(outbox.pending(100)) == 21


def test_what_waits_to_be_sent_again_is_bounded(
    path: Path, outbox: Outbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge.storage.outbox.RESENDS_MAX", 5)
    store(path, *(tick(seq) for seq in range(1, 9)))
    outbox.acknowledge([message.id for message in outbox.pending(100)])
    assert outbox.resend(1, 3) == 3
    with pytest.raises(RequestError, match="5 messages wait to be sent again, 2 of them from this span"):
        outbox.resend(4, 8)
    with pytest.raises(RequestError, match="0 of them from this span: ask for the rest"):
        outbox.resend(6, 8)
    first = outbox.pending(100)
    outbox.acknowledge([message.id for message in first])
    assert [seq for _, seq, _, _ in contents(first)] == [1, 2, 3, 4, 5]
    assert outbox.resend(6, 8) == 3


def test_events_are_sent_again_before_their_tick(path: Path, outbox: Outbox) -> None:
    store(path, eventful_tick(1))
    first = outbox.pending(10)
    outbox.acknowledge([message.id for message in first])
    assert outbox.resend(1, 1) == 3
    again = outbox.pending(10)
    assert [message.payload.replace('"is_resend":1', '"is_resend":0') for message in again] == [
        message.payload for message in first
    ]


def test_ticks_are_stored_while_messages_are_taken_away(path: Path, outbox: Outbox) -> None:
    storage = Storage(History.at(path, queue_ticks=5000), HandClock())
    first = storage.open()
    sent: list[int] = []
    for seq in range(first, first + 1000):
        storage.write(tick(seq))
        if seq % 50 == 0:
            messages = outbox.pending(40)
            outbox.acknowledge([message.id for message in messages])
            sent += [number for _, number, _, _ in contents(messages)]
    assert storage.close(20.0)
    sent += [number for _, number, _, _ in contents(outbox.pending(2000))]
    assert sent == list(range(first, first + 1000))


def test_without_a_history_the_outbox_says_so_and_makes_none(path: Path, outbox: Outbox) -> None:
    for call in (lambda: outbox.pending(1), outbox.depth, lambda: outbox.resend(1, 2)):
        with pytest.raises(sqlite3.OperationalError, match="not there"):
            call()
    outbox.acknowledge([1])
    assert not path.exists()


def test_a_broken_history_is_an_sqlite_error_for_the_outbox(path: Path, outbox: Outbox) -> None:
    path.write_bytes(b"no database" * 1000)
    with pytest.raises(sqlite3.Error):
        outbox.pending(1)


@pytest.mark.parametrize("limit", [1, 2, 10])
def test_rows_whose_tick_was_deleted_stall_nothing_and_leave_a_gap(
    path: Path, outbox: Outbox, limit: int
) -> None:
    store(path, tick(1), eventful_tick(2), tick(3), tick(4))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DELETE FROM ticks WHERE seq IN (1, 2)")
    assert [seq for _, seq, _, _ in contents(outbox.pending(limit))] == [3, 4][:limit]
    assert outbox.depth() == 2
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT first_seq, last_seq, reason FROM gaps ORDER BY 1").fetchall() == [
            (1, 1, "deleted or damaged before it was sent"),
            (2, 2, "deleted or damaged before it was sent"),
        ]


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE decisions SET why = '{' WHERE seq = 2",
        "UPDATE ticks SET sent_heater_duty = 'x' WHERE seq = 2",
        "UPDATE ticks SET mode = CAST(X'd143' AS TEXT) WHERE seq = 2",
        "UPDATE readings SET quality = 'other' WHERE seq = 2",
    ],
)
def test_a_damaged_tick_holds_up_no_other_and_leaves_a_gap(path: Path, outbox: Outbox, damage: str) -> None:
    store(path, tick(1), tick(2), tick(3))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(damage)
    assert [seq for _, seq, _, _ in contents(outbox.pending(10))] == [1, 3]
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT first_seq, last_seq FROM gaps").fetchall() == [(2, 2)]


def test_a_deleted_event_does_not_hold_up_its_tick(path: Path, outbox: Outbox) -> None:
    store(path, eventful_tick(1))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DELETE FROM events WHERE number = 1")
    assert [number for _, _, number, _ in contents(outbox.pending(10))] == [0, None]
