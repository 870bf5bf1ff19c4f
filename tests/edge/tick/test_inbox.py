"""edge/tick/inbox.py: requests reach the control thread, answers come back, and it is woken."""

import select
import threading
from collections.abc import Iterator
from contextlib import closing

import pytest

from edge.tick.inbox import ORDINARY, WAITING_MAX, Inbox


@pytest.fixture
def inbox() -> Iterator[Inbox]:
    with closing(Inbox()) as made:
        yield made


def test_a_request_wakes_the_loop_and_gets_its_answer(inbox: Inbox) -> None:
    replies: list[dict[str, object]] = []
    asking = threading.Thread(target=lambda: replies.append(inbox.ask({"do": "status"})))
    asking.start()
    assert select.select([inbox.wake], [], [], 5.0)[0] == [inbox.wake]
    letter = inbox.take()
    assert letter is not None
    letter.answer.put({"ok": True, "heard": letter.request["do"]})
    asking.join(timeout=5.0)
    assert replies == [{"ok": True, "heard": "status"}]
    assert select.select([inbox.wake], [], [], 0.0)[0] == []


def test_a_loop_that_does_not_answer_is_told(inbox: Inbox) -> None:
    reply = inbox.ask({"do": "status"}, timeout_s=0.01)
    assert reply["ok"] is False
    assert "did not answer" in reply["error"]


def test_ringing_without_end_does_not_block(inbox: Inbox) -> None:
    for _ in range(100_000):
        inbox.ring()
    assert inbox.take() is None


def test_closing_answers_who_waits_and_who_comes_later(inbox: Inbox) -> None:
    replies: list[dict[str, object]] = []
    asking = threading.Thread(target=lambda: replies.append(inbox.ask({"do": "status"}, timeout_s=60.0)))
    asking.start()
    assert select.select([inbox.wake], [], [], 5.0)[0] == [inbox.wake]  # the letter is there
    inbox.close()
    asking.join(timeout=5.0)
    assert not asking.is_alive()
    replies.append(inbox.ask({"do": "status"}, timeout_s=60.0))
    inbox.close()
    assert replies == [{"ok": False, "error": "the daemon is stopping"}] * 2


def taken(inbox: Inbox, lanes: int = ORDINARY + 1) -> list[str]:
    """Return the waiting requests in the order in which they are taken; each is answered."""
    found = []
    while (letter := inbox.take(lanes)) is not None:
        found.append(str(letter.request["do"]))
        letter.answer.put({"ok": True})
    return found


def test_a_stop_overtakes_maintenance_and_both_overtake_all_others(inbox: Inbox) -> None:
    for what in ("set_mode", "undo", "maintenance", "emergency_stop"):
        inbox.post({"do": what}, lambda reply: None)
    assert taken(inbox) == ["emergency_stop", "maintenance", "set_mode", "undo"]


def test_the_wake_up_lasts_until_the_last_letter_is_taken(inbox: Inbox) -> None:
    for what in ("set_mode", "undo"):
        inbox.post({"do": what}, lambda reply: None)
    inbox.take()
    assert select.select([inbox.wake], [], [], 0.0)[0] == [inbox.wake]
    inbox.take()
    assert select.select([inbox.wake], [], [], 0.0)[0] == []


def test_a_full_lane_says_busy_and_a_stop_still_finds_room(inbox: Inbox) -> None:
    replies: list[dict[str, object]] = []
    for number in range(WAITING_MAX + 5):
        inbox.post({"do": "set_reference", "reference_c": number}, replies.append)
    assert [reply["error"] for reply in replies] == ["busy: 32 requests wait already"] * 5
    inbox.post({"do": "emergency_stop"}, replies.append)
    assert taken(inbox) == ["emergency_stop", *["set_reference"] * WAITING_MAX]


def test_equal_requests_in_a_row_are_carried_out_once_and_each_gets_its_answer(inbox: Inbox) -> None:
    replies: list[dict[str, object]] = []
    for _ in range(1000):
        inbox.post({"do": "status"}, replies.append)
        inbox.post({"do": "emergency_stop"}, replies.append)
    assert taken(inbox) == ["emergency_stop", "status"]
    assert replies == [{"ok": True}] * 2000


def test_two_undos_in_a_row_are_two(inbox: Inbox) -> None:
    for _ in range(2):
        inbox.post({"do": "undo"}, lambda reply: None)
    assert taken(inbox) == ["undo", "undo"]


def test_a_release_that_came_before_a_stop_does_not_end_it(inbox: Inbox) -> None:
    replies: list[dict[str, object]] = []
    inbox.post({"do": "release_emergency_stop"}, replies.append)
    inbox.post({"do": "emergency_stop"}, replies.append)
    inbox.post({"do": "release_emergency_stop"}, replies.append)  # and one that came after it does
    assert replies == [{"ok": False, "error": "an emergency stop was given after this release"}]
    assert taken(inbox) == ["emergency_stop", "release_emergency_stop"]


def test_urgent_letters_can_be_taken_alone(inbox: Inbox) -> None:
    for what in ("set_mode", "maintenance", "emergency_stop"):
        inbox.post({"do": what}, lambda reply: None)
    assert taken(inbox, ORDINARY) == ["emergency_stop", "maintenance"]
    assert select.select([inbox.wake], [], [], 0.0)[0] == [inbox.wake]  # of the one that is left


def test_a_request_of_no_kind_at_all_is_an_ordinary_one(inbox: Inbox) -> None:
    for what in ([], {}, None, 7):
        inbox.post({"do": what}, lambda reply: None)
    assert len(taken(inbox)) == 4
