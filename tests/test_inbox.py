"""edge/inbox.py: requests reach the control thread, answers come back, and it is woken."""

import select
import threading

from edge.inbox import Inbox


def test_a_request_wakes_the_loop_and_gets_its_answer() -> None:
    inbox = Inbox()
    replies: list[dict[str, object]] = []
    asking = threading.Thread(target=lambda: replies.append(inbox.ask({"do": "status"})))
    asking.start()
    assert select.select([inbox.wake], [], [], 5.0)[0] == [inbox.wake]
    for letter in inbox.take():
        letter.answer.put({"ok": True, "heard": letter.request["do"]})
    asking.join(timeout=5.0)
    assert replies == [{"ok": True, "heard": "status"}]
    assert select.select([inbox.wake], [], [], 0.0)[0] == []
    inbox.close()


def test_a_loop_that_does_not_answer_is_told() -> None:
    inbox = Inbox()
    reply = inbox.ask({"do": "status"}, timeout_s=0.01)
    assert reply["ok"] is False
    assert "did not answer" in reply["error"]
    inbox.close()


def test_ringing_without_end_does_not_block() -> None:
    inbox = Inbox()
    for _ in range(100_000):
        inbox.ring()
    assert inbox.take() == []
    inbox.close()


def test_closing_answers_who_waits_and_who_comes_later() -> None:
    inbox = Inbox()
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
