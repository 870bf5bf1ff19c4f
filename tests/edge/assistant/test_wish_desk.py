"""assistant/requests/desk.py: nothing is applied without a confirmation, and nobody waits for a model."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest
from test_steering import TWIN, document, status

from edge.assistant.requests.desk import PROPOSAL_AGE_MAX_S, DeskParts, PendingRequest, WishDesk
from edge.config import loading as config
from edge.core.errors import DataError
from edge.twin.model import BoxTwin
from tests.support.broker import wait_for

pytestmark = pytest.mark.slow

SETTINGS = config.parse("timezone: UTC")


@dataclass
class Office:
    """A desk with a language model that answers when it is let to."""

    reply: Any = field(default_factory=document)
    now_utc: float = 1000.0
    orders: list[dict[str, Any]] = field(default_factory=list)
    told: list[dict[str, Any]] = field(default_factory=list)
    refuses: str = ""
    unsaved: str = ""
    standing: dict[str, Any] | None = None
    twin: BoxTwin | None = None

    def __post_init__(self) -> None:
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.done = threading.Event()
        around = DeskParts(SETTINGS, self._model, self._loop, lambda: self.twin, lambda: self.now_utc)
        self.desk = WishDesk(around)
        self.desk.listeners.append(self._told)

    def _model(self, messages: list[dict[str, str]]) -> Mapping[str, Any]:
        assert self.may_answer.wait(10.0)
        if isinstance(self.reply, Exception):
            raise self.reply
        return self.reply

    def _loop(self, request: Mapping[str, Any]) -> dict[str, Any]:
        if request["do"] == "status":
            return {"ok": True, **status(steering=self.standing)}
        if self.refuses:
            return {"ok": False, "error": self.refuses}
        self.orders.append(dict(request))
        self.standing = request.get("steering")
        if self.unsaved:
            return {"ok": False, "error": self.unsaved, **status(steering=self.standing)}
        return {"ok": True}

    def _told(self, proposal: dict[str, Any]) -> None:
        self.told.append(proposal)
        if proposal["state"] != "thinking":
            self.done.set()

    def ask(self, words: Any = "20 at night") -> dict[str, Any]:
        """Ask and wait for what comes of it."""
        self.done.clear()
        answer = self.desk.answer({"do": "ask", "words": words})
        assert answer["ok"], answer
        assert self.done.wait(20.0)
        return self.desk.answer({"do": "proposal", "id": answer["proposal"]["id"]})["proposal"]

    def confirm(self, id: Any) -> dict[str, Any]:
        return self.desk.answer({"do": "confirm", "id": id})


def test_a_wish_becomes_a_proposal_and_nothing_is_ordered() -> None:
    office = Office(twin=TWIN)
    proposal = office.ask()
    assert proposal["state"] == "ready"
    assert proposal["changes"][0] == "reference every day: 26 °C from 06:00, 20 °C from 22:00"
    assert proposal["effect"]["then"]["heat_wh"] >= 0
    assert [told["state"] for told in office.told] == ["thinking", "ready"]
    assert office.told[-1] == proposal
    assert not office.orders


def test_a_confirmation_orders_it_once() -> None:
    office = Office()
    proposal = office.ask()
    assert office.confirm(proposal["id"])["ok"]
    assert office.orders == [{"do": "steer", "steering": proposal["steering"]}]
    again = office.confirm(proposal["id"])
    assert not again["ok"]
    assert "confirmed" in again["error"]
    assert len(office.orders) == 1


@pytest.mark.parametrize(
    ("after_s", "error"),
    [(PROPOSAL_AGE_MAX_S - 0.1, ""), (PROPOSAL_AGE_MAX_S, "expired"), (-1.0, "expired")],
    ids=["just in time", "too late", "the clock was set back"],
)
def test_a_proposal_that_nobody_confirmed_expires(after_s: float, error: str) -> None:
    office = Office()
    proposal = office.ask()
    office.now_utc += after_s
    assert error in office.confirm(proposal["id"]).get("error", "")
    assert len(office.orders) == (not error)


def test_every_new_state_of_a_proposal_is_published() -> None:
    office = Office()
    proposal = office.ask()
    office.confirm(proposal["id"])
    assert office.desk.answer({"do": "undo"})["ok"]
    assert [told["state"] for told in office.told] == ["thinking", "ready", "confirmed", "undone"]
    other = office.ask()
    office.now_utc += PROPOSAL_AGE_MAX_S
    office.confirm(other["id"])
    assert [told["state"] for told in office.told[4:]] == ["thinking", "ready", "expired"]
    assert {told["id"] for told in office.told[4:]} == {other["id"]}


def test_confirmation_and_undo_reach_the_loop_with_their_author() -> None:
    office = Office()
    proposal = office.ask()
    office.desk.answer({"do": "confirm", "id": proposal["id"], "by": "Ann (page)"})
    office.desk.answer({"do": "undo", "by": "Bob (page)"})
    assert [(order["do"], order["by"]) for order in office.orders] == [
        ("steer", "Ann (page)"),
        ("undo", "Bob (page)"),
    ]


def test_an_expired_proposal_is_published_without_being_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.assistant.requests.desk.PROPOSAL_AGE_MAX_S", -0.99)  # the timer adds a second
    office = Office()
    office.desk.answer({"do": "ask", "words": "20 at night"})
    wait_for(lambda: [told["state"] for told in office.told] == ["thinking", "ready", "expired"])


def test_a_discarded_proposal_is_published_once_and_cannot_be_confirmed() -> None:
    office = Office()
    proposal = office.ask()
    discard = {"do": "discard", "id": proposal["id"]}
    assert office.desk.answer(discard)["proposal"]["state"] == "discarded"
    assert office.told[-1]["text"] == f"discarded: {proposal['text']}"
    assert "cannot be discarded: discarded" in office.desk.answer(discard)["error"]
    assert "discarded" in office.confirm(proposal["id"])["error"]
    assert not office.orders
    assert [told["state"] for told in office.told] == ["thinking", "ready", "discarded"]


def test_what_is_carried_out_can_be_undone_and_not_discarded() -> None:
    office = Office()
    proposal = office.ask()
    office.confirm(proposal["id"])
    assert "confirmed" in office.desk.answer({"do": "discard", "id": proposal["id"]})["error"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"state": "none", "words": ""}, "nothing was asked for"),
        ({}, "thinking about: warmer"),
        (
            {"state": "ready", "changes": ("26 °C from 06:00", "until Monday")},
            "26 °C from 06:00; until Monday",
        ),
        ({"state": "question", "said": "By day?"}, "By day?"),
        ({"state": "failed", "error": "rate limited"}, "failed: rate limited"),
        ({"state": "expired", "changes": ("26 °C",)}, "expired: 26 °C"),
        ({"state": "undone"}, "undone: warmer"),
    ],
)
def test_each_state_reads_as_one_sentence(changes: dict[str, Any], text: str) -> None:
    assert PendingRequest(**{"id": "c0ffee", "words": "warmer", "asked_utc": 0.0, **changes}).text == text


def test_the_lines_are_the_changes_and_the_next_day_with_and_without_them() -> None:
    proposal = Office(twin=TWIN).ask()
    assert proposal["lines"][: len(proposal["changes"])] == proposal["changes"]
    heat = next(line for line in proposal["lines"] if line.startswith("heat: "))
    now, then = (proposal["effect"][when]["heat_wh"] for when in ("now", "then"))
    assert heat == f"heat: {now:g} Wh as it is, {then:g} Wh then"
    assert Office().ask()["lines"][-1].startswith("no prediction:")


def test_an_undo_that_the_loop_refuses_changes_no_proposal() -> None:
    office = Office()
    proposal = office.ask()
    office.confirm(proposal["id"])
    office.refuses = "undo: nothing that was asked for in words is standing"
    assert not office.desk.answer({"do": "undo"})["ok"]
    assert office.told[-1]["state"] == "confirmed"


def test_an_undo_after_a_restart_names_what_the_loop_carried_out() -> None:
    before = Office()
    steering = before.ask()["steering"]
    office = Office(standing=steering)
    assert office.desk.answer({"do": "undo"})["ok"]
    assert [(told["id"], told["state"]) for told in office.told] == [(steering["id"], "undone")]


def test_an_order_that_is_in_force_but_not_on_disk_counts_as_confirmed() -> None:
    office = Office()
    proposal = office.ask()
    office.unsaved = "in force now, but it will not survive a restart"
    answer = office.confirm(proposal["id"])
    assert not answer["ok"] and answer["error"] == office.unsaved
    assert office.told[-1]["state"] == "confirmed"


def test_an_order_that_the_loop_refuses_can_be_confirmed_again() -> None:
    office = Office(refuses="the daemon is stopping")
    proposal = office.ask()
    assert office.confirm(proposal["id"]) == {"ok": False, "error": "the daemon is stopping"}
    office.refuses = ""
    assert office.confirm(proposal["id"])["ok"]


def test_asking_does_not_wait_for_the_model_and_a_second_wish_is_refused_meanwhile() -> None:
    office = Office()
    office.may_answer.clear()
    first = office.desk.answer({"do": "ask", "words": "warmer"})
    assert first["proposal"]["state"] == "thinking"
    assert "still being worked on" in office.desk.answer({"do": "ask", "words": "colder"})["error"]
    assert not office.confirm(first["proposal"]["id"])["ok"]
    office.may_answer.set()
    assert office.done.wait(20.0)
    assert office.confirm(first["proposal"]["id"])["ok"]


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (DataError("rate limited"), "rate limited"),
        (ZeroDivisionError("oops"), "internal error"),
        (document(hours=1000), "hours: 1000 is above"),
        ({}, "missing"),
    ],
)
def test_a_model_that_fails_is_told_and_changes_nothing(reply: Any, error: str) -> None:
    office = Office(reply=reply)
    proposal = office.ask()
    assert (proposal["state"], proposal["steering"]) == ("failed", None)
    assert error in proposal["error"]
    assert not office.confirm(proposal["id"])["ok"]
    assert not office.orders
    assert office.ask()["state"] == "failed"  # and one may ask again


def test_a_model_that_asks_back_is_passed_on() -> None:
    proposal = Office(reply=document(question="By day or by night?")).ask()
    assert (proposal["state"], proposal["said"]) == ("question", "By day or by night?")


@pytest.mark.parametrize("words", ["", "   ", "x" * 501])
def test_words_that_are_none_or_too_many_are_refused(words: Any) -> None:
    assert "1 to 500 characters" in Office().desk.answer({"do": "ask", "words": words})["error"]


@pytest.mark.parametrize("id", ["", "zz"])
def test_an_unknown_proposal_is_told(id: Any) -> None:
    assert "never made or is forgotten" in Office().confirm(id)["error"]


def test_old_proposals_are_forgotten() -> None:
    office = Office()
    first = office.ask()
    for _ in range(8):
        office.ask()
    assert "forgotten" in office.confirm(first["id"])["error"]


def test_a_rig_without_a_language_model_says_so() -> None:
    desk = WishDesk(DeskParts(SETTINGS, None, lambda request: {}, lambda: None, lambda: 0.0))
    assert "llm.url is empty" in desk.answer({"do": "ask", "words": "warmer"})["error"]
