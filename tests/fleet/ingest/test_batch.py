"""Meanings of messages: states, availability, answers, and what is not believed."""

import json
from pathlib import Path
from typing import Any

import pytest
from history_records import START_UTC, tick
from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.formats.tick_json import tick_json
from edge.twin.twin_file import twin_of
from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.ingest.batch import Batch, Times
from fleet.ingest.books import Books, Entry
from fleet.ingest.inbox import Message
from fleet.ingest.ledger import HistoryLedger, RigLedger
from fleet.ingest.spans import Spans
from fleet.ingest.tick import PAYLOAD_MAX
from fleet.settings import DatabaseSettings

NOW = START_UTC + 3600.0
TIMES = Times(NOW, 100.0, START_UTC - 86400.0)


def hear(what: str, payload: Any, ledger: RigLedger | None = None, size: int = 0) -> Batch:
    raw = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    batch = Batch(TIMES)
    batch.hear(Message("rig-1", what, raw, size or len(raw), 1, 1, 1, 99.0), ledger or RigLedger(0.0))
    return batch


def refusals(batch: Batch) -> list[tuple[str, str]]:
    return [(error.reason, str(error)) for _, error in batch.refused]


def test_a_state_is_kept_and_tells_the_newest_tick() -> None:
    ledger = RigLedger(0.0)
    batch = hear("state", {"seq": 7, "temp_air_c": 21.5, "mode": "auto", "co2_ppm": None}, ledger)
    assert batch.rigs["rig-1"]["state"] == {"seq": 7, "temp_air_c": 21.5, "mode": "auto", "co2_ppm": None}
    assert ledger.told == 7


def test_availability_is_one_of_two_words() -> None:
    ledger = RigLedger(0.0)
    assert hear("availability", b"online", ledger).rigs["rig-1"] == {"is_online": True, "last_utc": NOW}
    assert hear("availability", b"offline", ledger).rigs["rig-1"] == {"is_online": False, "last_utc": NOW}
    assert hear("availability", b"maybe", ledger).refused[0][1].reason == "value"
    assert not ledger.is_online


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ({"seq": -1}, "seq"),
        ({"seq": "7"}, "seq"),
        ({}, "seq"),
        ({"seq": 7, "temp_air_c": "warm"}, "value"),
        ({"seq": 7, "temp_air_c": 1e30}, "value"),
        ({"seq": 7, "inner": {"a": 1}}, "value"),
        ({"seq": 7, **{f"k{number}": number for number in range(200)}}, "value"),
        (b"no JSON", "json"),
    ],
)
def test_a_state_that_is_none_is_refused(state: Any, reason: str) -> None:
    batch = hear("state", state)
    assert [found for found, _ in refusals(batch)] == [reason]
    assert "state" not in batch.rigs["rig-1"]


@pytest.mark.parametrize("what", ["state", "history/tick"])
def test_a_payload_that_was_too_large_is_refused_by_its_size(what: str) -> None:
    batch = hear(what, b"", size=10 << 20)
    assert refusals(batch) == [("size", f"{what}: 10485760 bytes; {PAYLOAD_MAX} at most")]


def test_a_tick_with_an_unknown_quantity_is_stored_and_told() -> None:
    body = {"history_id": "h1", "is_resend": 0, **tick_json(tick(5)), "new_quantity": 1.0}
    batch = hear("history/tick", body)
    assert [each.seq for each in batch.ticks] == [5]
    assert refusals(batch) == [("quantity", "tick 5: unknown: new_quantity")]


@pytest.mark.parametrize("what", ["availability", "state", "twin"])
def test_a_retained_topic_that_was_emptied_is_no_refusal_and_no_word_of_the_rig(what: str) -> None:
    ledger = RigLedger(0.0)
    ledger.is_online = True
    batch = hear(what, b"", ledger)
    assert (batch.refused, batch.rigs) == ([], {})
    assert (batch.gone == {"rig-1"}) == (not ledger.is_online) == (what == "availability")


@pytest.mark.parametrize(("is_known", "rows"), [(True, [("rig-1", False)]), (False, [])])
def test_a_rig_that_is_gone_is_offline_and_gets_no_row_anew(
    tmp_path: Path, is_known: bool, rows: list[tuple[str, bool]]
) -> None:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))
    if is_known:
        Books(engine).write(Entry(1.0, {"rig-1": {"is_online": True}}))
    Books(engine).write(Entry(2.0, gone={"rig-1"}))
    with Session(engine) as session:
        assert [tuple(row) for row in session.execute(select(FleetRig.name, FleetRig.is_online))] == rows
    engine.dispose()


def asked() -> RigLedger:
    """A rig that was asked for ticks 2 to 4."""
    ledger = RigLedger(0.0)
    ledger.load({"h1": HistoryLedger(Spans([(1, 1), (5, 6)]))})
    assert ledger.asks.look(ledger.missing(), 100.0) == (2, 4)
    return ledger


def answer(**changes: Any) -> dict[str, Any]:
    return {"command": "resend", "ok": True, "queued": 0, "first_seq": 2, "last_seq": 4, **changes}


def test_ticks_that_a_rig_has_not_are_noted() -> None:
    assert hear("reply", answer(), asked()).absent == [("rig-1", "h1", (2, 4))]


@pytest.mark.parametrize(
    "changes",
    [
        {"queued": 3},
        {"ok": False},
        {"first_seq": 1},  # somebody else's request
        {"command": "mode"},
        {"queued": None},
        {"queued": "0"},
    ],
)
def test_no_other_answer_says_that_ticks_are_absent(changes: dict[str, Any]) -> None:
    batch = hear("reply", answer(**changes), asked())
    assert batch.absent == []
    assert batch.refused == []


def test_our_own_mistake_is_counted_and_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.ingest.batch.parse_state", lambda payload: 1 / 0)
    batch = hear("state", {"seq": 1})
    assert refusals(batch) == [("fault", "state: ZeroDivisionError('division by zero')")]


def told_twin(**effects: Any) -> dict[str, Any]:
    return {"bundle": "box-2", "twin": {"sample_s": 60.0, "effects": effects}}


def test_a_twin_is_kept_as_its_file_has_it_and_taken_back() -> None:
    heard = hear("twin", told_twin(wall_loss={"UA": {"value": 2.5, "low": 2.0, "high": 3.0}})).twins["rig-1"]
    assert heard is not None and heard.bundle == "box-2"
    assert twin_of(heard.document).effects["wall_loss"]["UA"].value == 2.5
    assert hear("twin", b"").twins == {"rig-1": None}


@pytest.mark.parametrize(
    ("told", "named"),
    [
        (told_twin(wall_loss={"UA": "a lot"}), "effects.wall_loss.UA"),
        (told_twin(no_effect={"UA": 1.0}), "no_effect"),
        (told_twin(wall_loss={"UA": -1e300}), "UA"),
        ({"bundle": "../../etc", "twin": {}}, "no bundle's name"),
        ({"bundle": "box-2", "twin": [1]}, "there is no twin"),
        (b"no JSON", ""),
    ],
)
def test_a_twin_that_is_none_is_refused(told: Any, named: str) -> None:
    batch = hear("twin", told)
    ((_, text),) = refusals(batch)
    assert named in text and batch.twins == {}
