"""bench/wishes: each sentence has an answer that is right, and a wrong one is told from it."""

import json
from pathlib import Path

import pytest
from llm_parts import ScriptedLine, says

from bench.wishes import __main__ as wishes
from bench.wishes.wish import Wish, WishEnd, hidden_values, read_wishes
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.requests.prediction import describe
from edge.config import loading
from edge.tick.steering import DailyTarget, FanRest, Steering

NOW = wishes.NOW
NOTHING = {
    "reference": [], "heater_penalty": None, "fan_penalty": None, "heater_max_duty": None, "fan_rest": [],
    "hours": 24, "understood": "", "question": "",
}  # fmt: skip
BY_ID = {wish.id: wish for wish in read_wishes()}


def ended(wish: Wish, tmp_path: Path, content: str) -> tuple[str, str]:
    """The verdict on an answer, and the reason that nothing came."""
    settings = loading.default()
    model: LanguageModel = wishes.open_model("http://model.test/v1", "m", tmp_path, settings)
    model.endpoint.line = ScriptedLine(says(content)).post
    outcome, steering, reason = wishes.put(wish, "", model, settings)
    return wish.verdict(outcome, steering, NOW), reason


def answer(**keys: object) -> str:
    return json.dumps({**NOTHING, **keys})


def targets(*pairs: tuple[str, float]) -> list[dict[str, object]]:
    return [{"from": clock, "degc": degc} for clock, degc in pairs]


def test_there_are_a_hundred_in_three_languages_each_once() -> None:
    found = read_wishes()
    assert len(found) == len(BY_ID) == len({wish.words for wish in found}) == 100
    assert {wish.language for wish in found} == {"en", "de", "no"}
    assert all(wish.ranges for wish in found if wish.best is WishEnd.SETTINGS)


@pytest.mark.parametrize(
    ("id", "keys", "verdict"),
    [
        ("en02", {"reference": targets(("06:00", 26), ("22:00", 20))}, "right"),
        ("en02", {"reference": targets(("06:00", 20), ("22:00", 26))}, "wrong"),
        ("en02", {"reference": targets(("06:00", 26), ("22:00", 20)), "fan_penalty": 5}, "wrong"),
        ("en02", {"reference": targets(("06:00", 26), ("22:00", 20)), "hours": 1}, "wrong"),
        ("en02", {"question": "Which day?"}, "ask"),
        ("en03", {"question": "How much warmer?"}, "right"),
        ("en03", {"reference": targets(("00:00", 25))}, "right"),
        ("en03", {"reference": targets(("00:00", 23))}, "wrong"),
        ("en09", {"fan_rest": [{"from": "22:00", "until": "07:00"}]}, "right"),
        ("en09", {"fan_rest": [{"from": "07:00", "until": "22:00"}]}, "wrong"),
        ("en11", {"heater_max_duty": 0.5}, "right"),
        ("en11", {"heater_max_duty": 0.05}, "wrong"),
        ("en15", {"reference": targets(("00:00", 60))}, "right"),
        ("en15", {"reference": targets(("00:00", 38))}, "wrong"),
        ("en19", {"reference": targets(("00:00", 24))}, "wrong"),
        ("en21", {"reference": targets(("00:00", 38)), "heater_max_duty": 1, "hours": 168}, "wrong"),
        ("no01", {"reference": targets(("00:00", 24))}, "right"),
    ],
)  # fmt: skip
def test_a_verdict(tmp_path: Path, id: str, keys: dict[str, object], verdict: str) -> None:
    assert ended(BY_ID[id], tmp_path, answer(**keys))[0] == verdict


def test_words_instead_of_an_answer_are_nothing(tmp_path: Path) -> None:
    verdict, reason = ended(BY_ID["en01"], tmp_path, "Of course, I have set it to 26.")
    assert verdict == "nothing"
    assert "malformed" in reason


def test_no_value_of_a_proposal_is_missing_in_the_text_for_confirmation() -> None:
    steering = Steering(
        "x", "w", NOW + 3600.0, (DailyTarget(0.0, 25.0),), 2.0, 3.0, 0.5, (FanRest(0.0, 3600.0),)
    )
    shown = describe(steering, None)
    assert hidden_values(steering, shown, lambda one: describe(one, None)) == []
    assert "daily" in hidden_values(steering, shown, lambda one: shown)


def test_the_table_counts_every_wish_once(tmp_path: Path) -> None:
    settings = loading.default()
    model = wishes.open_model("http://model.test/v1", "m", tmp_path, settings)
    model.endpoint.line = ScriptedLine(says(answer(question="What?"))).post
    lines = wishes.score(model, settings, read_wishes())
    asked_rightly = sum(WishEnd.ASK in (wish.best, *wish.also) for wish in read_wishes())
    first = next(place for place, line in enumerate(lines) if not line[:18].strip())
    counted = {
        line[:18].strip(): [int(word) for word in line[18:].split()] for line in lines[first + 1 : first + 6]
    }
    languages = [counted[name] for name in ("en", "de", "no")]
    assert [sum(column) for column in zip(*languages, strict=True)] == [
        asked_rightly, 100 - asked_rightly, 0, 0, 0
    ]  # fmt: skip
    assert sum(counted["wants settings"]) + sum(counted["wants no settings"]) == 100
    assert f"who always asks back would be right in {asked_rightly}" in lines
    assert lines[-2].endswith("none")


REMEMBERED = {wish.id: wish for wish in read_wishes(wishes.REMEMBERED)}


def test_the_wishes_that_refer_to_earlier_ones_are_others_and_each_has_facts() -> None:
    assert len(REMEMBERED) == len({wish.id for wish in read_wishes(wishes.REMEMBERED)}) == 32
    assert not REMEMBERED.keys() & BY_ID.keys()
    assert {wish.language for wish in REMEMBERED.values()} == {"en", "de", "no"}
    assert all(wish.facts for wish in REMEMBERED.values())
    assert all(fact.utc < NOW for wish in REMEMBERED.values() for fact in wish.facts)


@pytest.mark.parametrize("id", REMEMBERED)
def test_all_that_a_wish_refers_to_is_in_its_data_block_and_nothing_that_was_erased(
    tmp_path: Path, id: str
) -> None:
    wish = REMEMBERED[id]
    block = wishes.memory_of(wish, tmp_path / "history.db", loading.default())
    told = json.loads(block.splitlines()[1])["facts"]
    assert [(fact["kind"], fact.get("by", "")) for fact in told] == [
        (fact.kind.value, fact.by) for fact in wish.facts if not fact.erased
    ]
    for fact in wish.facts:
        shown = any((fact.text or f'"{fact.words}"') in each["text"] for each in told)
        assert shown is not fact.erased
    assert block.count("<") == 2


def test_with_memory_each_question_holds_its_facts_and_without_it_none(tmp_path: Path) -> None:
    settings = loading.default()
    model = wishes.open_model("http://model.test/v1", "m", tmp_path, settings)
    line = ScriptedLine(says(answer(question="What?")))
    model.endpoint.line = line.post
    few = list(REMEMBERED.values())[8:14]
    lines = list(wishes.compare(model, settings, few, tmp_path))
    asked = [body["messages"] for body in line.bodies]
    assert len(asked) == 12
    assert not [True for messages in asked[:6] if "memory" in messages[1]["content"]]
    assert all('<data source="memory">' in messages[1]["content"] for messages in asked[6:])
    asked_rightly = sum(WishEnd.ASK in (wish.best, *wish.also) for wish in few)
    assert lines.count(f"who always asks back would be right in {asked_rightly}") == 2
    assert [line for line in lines if "memory" in line] == [
        "without memory",
        "with memory, at most 800 tokens",
    ]
