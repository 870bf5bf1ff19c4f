"""llm/claims.py: what a text surely claims is held against what is known; nothing else is judged."""

from typing import Any

import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st

from edge.assistant.llm.claims import KnownFacts, check_claims
from edge.assistant.llm.ledger import Ledger
from edge.core.messages import Command

DRIVEN = Command(0.45, False)
ROWS = [[1.0, 24.31], [2.0, 27.94], [3.0, 0.3]]


def known(simulated: bool = True, read: bool = True, driven: Command = DRIVEN) -> KnownFacts:
    ledger = Ledger()
    if simulated:
        for number in (1, 2):
            result = {
                "heater_duty": [0.1 * number],
                "temp_air_c": [24.2, 25.0 + number],
                "mean_abs_error_k": 0.5,
            }
            ledger.record("simulate", {}, {**result, "fan_on": [False], "target_c": [26.0, 26.0]})
    if read:
        ledger.record("sql", {"query": "SELECT"}, {"rows": ROWS, "coverage": {"rows": 3}})
    return KnownFacts(context(temp=24.04, reference=26.0, last_sent=driven), ledger, Command(0.2, False))


def verdicts(text: str, about: KnownFacts | None = None) -> list[tuple[str, bool]]:
    return [(claim.kind, claim.holds) for claim in check_claims(text, about or known())]


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("The fan is off.", "state"),
        ("The fan is currently off and stays so.", "state"),
        ("The heater is on.", "state"),
        ("The heater is at 0.45.", "state"),
        ("The heater duty is 45 %.", "state"),
        ("The target is 26 degC.", "told"),
        ("The current temperature is 24.0 °C.", "told"),
        ("The ambient temperature is 21 degrees.", "told"),
        ("The simulation simulate-2 shows 27.0 degC at its end.", "simulation"),
        ("Simulate-1 predicts 26 degC, which is the target of 26 degC.", "simulation"),
        ("I simulated a duty of 0.2.", "simulation"),
        ("The history shows a maximum of 27.9 degC.", "history"),
        ("According to the database, 0.3 Wh were used.", "history"),
    ],
)
def test_what_is_so_holds(text: str, kind: str) -> None:
    found = verdicts(text)
    assert found and all(each == (kind, True) for each in found)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("The fan is on.", "state"),
        ("The fan is now on, as you can see.", "state"),
        ("The fan has been turned on.", "state"),
        ("The heater is off.", "state"),
        ("The heater is at 0.5.", "state"),
        ("The heater is at 60%.", "state"),
        ("I have turned the fan on.", "action"),
        ("I've just switched the fan on to cool.", "action"),
        ("I have set the heater to 45 %.", "action"),
        ("We have lowered the heater duty.", "action"),
        ("The target is 25 degC.", "told"),
        ("The current temperature is 24.5 °C.", "told"),
        ("The room is at 19 degC.", "told"),
        ("The simulation simulate-1 shows 27.0 degC at its end.", "simulation"),
        ("simulate-9 predicts 26.00 degC.", "simulation"),
        ("The simulation shows 26.4 degC.", "simulation"),
        ("The history shows a maximum of 31 degC.", "history"),
        ("The records say that 2 kWh were used.", "history"),
        ("That took 2.5 kWh.", "history"),
    ],
)
def test_what_is_not_so_is_flagged(text: str, kind: str) -> None:
    assert (kind, False) in verdicts(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Because it is warm enough.",
        "I would turn the fan on if it were hotter.",
        "The fan should be off.",
        "I propose to set the heater to 0.9.",
        "The heater will be at 0.9 so that the air reaches 26 degC.",
        "A duty of 0.9 is best.",
        "Turning the fan on could cool the box to 22 degC.",
        "Three steps are enough.",
        "The fan is on average not needed.",
        "Heating by 2 degrees takes a while.",
        "I have chosen a moderate heat.",
        "I recommend that the fan is on.",
    ],
)
def test_what_cannot_be_looked_up_is_not_judged(text: str) -> None:
    assert verdicts(text) == []


def test_a_tool_that_was_not_asked_shows_nothing() -> None:
    nothing = known(simulated=False, read=False)
    assert verdicts("The simulation shows 26.00 degC.", nothing) == [("simulation", False)]
    assert verdicts("The history shows 26 degC.", nothing) == [("history", False)]


@pytest.mark.parametrize(
    ("result", "holds"),
    [
        ({"temp_air_c": [25.0, 33.0]}, True),
        ({"temp_air_c": (25.0, 33.0)}, True),
        ({"end": {"temp_air_c": {"last": 33}}}, True),
        ({"runs": [{"temp_air_c": [[33.0]]}]}, True),
        ({"temp_air_c": [25.0], "note": "33"}, False),
        ({"33": 25.0}, False),
        ({"temp_air_c": [25.0, None]}, False),
    ],
)
def test_a_number_is_found_wherever_it_stands_in_a_result(result: dict[str, Any], holds: bool) -> None:
    about = known(simulated=False, read=False)
    about.ledger.record("simulate", {}, result)
    assert verdicts("The simulation shows 33 degC.", about) == [("simulation", holds)]


@pytest.mark.parametrize(("flag", "said"), [(True, "1.00"), (False, "0.00")])
def test_a_flag_is_not_a_number(flag: bool, said: str) -> None:
    about = known(simulated=False, read=False)
    about.ledger.record("simulate", {}, {"temp_air_c": [25.0], "fan_on": [flag]})
    assert verdicts(f"The simulation shows {said} degC.", about) == [("simulation", False)]


def test_the_echo_decides_what_is_on() -> None:
    running = known(driven=Command(0.0, True))
    assert verdicts("The fan is on.", running) == [("state", True)]
    assert verdicts("The heater is on.", running) == [("state", False)]


def test_a_heater_at_a_small_duty_is_one_that_was_turned_on() -> None:
    warming = known(driven=Command(0.05, False))
    assert verdicts("I have turned the heater on.", warming) == [("action", True)]
    assert verdicts("I have turned the heater off.", warming) == [("action", False)]


def test_several_sentences_are_judged_one_by_one() -> None:
    text = "The fan is off. I have turned the fan on! The simulation shows 26.00 degC; the target is 26 degC."
    assert verdicts(text) == [("state", True), ("action", False), ("simulation", True), ("told", True)]


@pytest.mark.parametrize(
    ("said", "holds"), [("24.0", True), ("24.04", True), ("24.1", False), ("24", True), ("25", False)]
)
def test_a_number_holds_to_the_digits_it_is_given_with(said: str, holds: bool) -> None:
    assert verdicts(f"The current temperature is {said} degC.") == [("told", holds)]


def test_claims_are_json_and_few() -> None:
    found = check_claims("The fan is on. " * 50, known())
    assert len(found) == 12
    assert found[0].to_json() == {
        "text": "The fan is on.",
        "kind": "state",
        "holds": False,
        "against": "the board confirmed heater 0.45, fan off",
    }


WORDS = st.sampled_from(
    [*("I have turned", "the fan", "on", "off", "is", "heater", "at", "0.45", "26", "degC", "%", "kWh"),
     *("simulation", "history", "shows", ".", ";", "target")]
)  # fmt: skip


@given(st.text() | st.lists(WORDS, max_size=30).map(" ".join))
def test_any_text_is_judged_without_a_fault(text: str) -> None:
    for claim in check_claims(text, known()):
        values: dict[str, Any] = claim.to_json()
        assert len(values["text"]) <= 160
