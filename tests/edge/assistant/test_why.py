"""edge/assistant/why: why a command was sent, told from what was recorded."""

from datetime import UTC
from pathlib import Path
from typing import Any

import pytest
from history_records import START_UTC, eventful_tick, store, tick

from edge.__main__ import main
from edge.assistant.why.ask_history import explain, reasons, why
from edge.core.errors import DataError
from edge.core.messages import Change, Command, Decision, TickRecord

PLAN = {
    "cost": 12.5,
    "cost_tracking": 11.0,
    "cost_heater": 1.0,
    "cost_fan": 0.5,
    "model": "arx 884880b1",
    "binding": ["heater at its upper limit"],
    "runner_up": {"heater_duty": 0.95, "fan_on": False, "cost_more": 0.031},
}


def told(record: TickRecord) -> str:
    return "\n".join(explain(record, UTC))


def decided(why: dict[str, Any], controller: str = "MPC-P", **values: Any) -> TickRecord:
    return tick(20, decision=Decision(Command(1.0), controller, (25.1, 25.2), why), **values)


def test_the_command_comes_first_with_its_time() -> None:
    assert explain(tick(20), UTC)[0] == (
        "Tick 20, 2026-01-01 00:20:00: sent heater 1.00, fan off, confirmed by the board."
    )


def test_what_was_seen_is_told() -> None:
    assert "measured at 25.0 °C, estimated at 25.00 °C, the room 21.0 °C; the reference was 26.0 °C" in told(
        tick(20)
    )


def test_a_plan_is_told_with_its_costs_and_what_bound_it() -> None:
    text = told(decided(PLAN))
    assert (
        "MPC-P wanted heater 1.00, fan off and expected 25.10 °C after the step, 25.20 °C after 2 steps."
        in text
    )
    assert "costs 12.5 by arx 884880b1: tracking 11, heater 1, fan 0.5" in text
    assert "What bound it: heater at its upper limit." in text
    assert "The next best began with heater 0.95, fan off, and costs 0.031 more." in text


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rule": "below the reference: heat"}, "Its rule: below the reference: heat."),
        (
            {"policy": "RL-Off 1a2b", "value": -3.21, "margin": 0.5},
            "worth -3.21, 0.5 more than the next best.",
        ),
        ({"rationale": "it is cold"}, 'The language model said: "it is cold"'),
        (
            {
                "claims": [
                    {"text": "the fan is on", "holds": False, "against": "fan off"},
                    {"text": "x", "holds": True},
                ]
            },
            'That does not hold: "the fan is on" (fan off).',
        ),
        ({"time_box_fired": True}, "The time limit ended its search."),
    ],
)
def test_every_kind_of_controller_has_its_sentence(values: dict[str, Any], sentence: str) -> None:
    (line,) = reasons(values)
    assert line.endswith(sentence)


@pytest.mark.parametrize("values", [{}, {"binding": []}, {"runner_up": None}, {"claims": []}, {"unknown": 1}])
def test_what_a_why_does_not_hold_is_not_told(values: dict[str, Any]) -> None:
    assert not list(reasons(values))


def test_a_fallback_says_instead_of_whom_and_why() -> None:
    text = told(decided({"rule": "wait", "instead_of": "LLM-Te0", "failure": "controller.late"}, "rules"))
    assert "rules decided, since LLM-Te0 did not: controller.late." in text


def test_nobody_deciding_is_told() -> None:
    text = told(decided({"failure": "estimate.old"}, "none"))
    assert "No controller decided: estimate.old; what heats or blows stays off." in text
    assert "none wanted" not in text


def test_changes_name_who_made_them() -> None:
    changes = (
        Change("operator.orders", "fan_on", 1.0, 0.0, "mode heat, fan auto"),
        Change("heater.slew", "heater_duty", 1.0, 0.5, "rise is limited"),
    )
    text = told(decided(PLAN, changes=changes))
    assert "Standing orders changed fan_on from 1 to 0: mode heat, fan auto (operator.orders)." in text
    assert "Safety changed heater_duty from 1 to 0.5: rise is limited (heater.slew)." in text
    assert "Safety changed nothing." in told(tick(20))


def test_a_command_by_hand_is_not_told_as_the_controllers() -> None:
    text = told(decided(PLAN, mode="manual"))
    assert "stood by hand, whatever MPC-P wanted." in text
    assert "MPC-P wanted heater" not in text


def test_a_tick_with_everything_odd_is_told() -> None:
    text = told(eventful_tick(3))
    assert "which the board did not confirm" in text
    assert "not good (fault), by the estimate not known" in text
    assert "At that tick: silent for 3 s; Ü (board.link_lost)." in text


@pytest.fixture
def history(tmp_path: Path) -> Path:
    path = tmp_path / "history.db"
    store(path, *(tick(number) for number in (1, 2, 3, 30)))
    return path


def test_the_newest_tick_is_the_usual(history: Path) -> None:
    assert why(history, None, UTC)["seq"] == 30


@pytest.mark.parametrize(
    ("after_s", "seq"), [(60.0, 1), (119.9, 1), (120.0, 2), (180.0, 3), (250.0, 3), (1e9, 30)]
)
def test_the_command_that_held_then_is_found(history: Path, after_s: float, seq: int) -> None:
    assert why(history, START_UTC + after_s, UTC)["seq"] == seq


def test_a_time_without_ticks_is_told(history: Path) -> None:
    lines = why(history, START_UTC + 180.0 + 900.0, UTC)["lines"]
    assert lines[0] == "Nothing is recorded at that time; the last tick before it was 15 minutes earlier."
    assert why(history, START_UTC + 180.0 + 119.0, UTC)["lines"][0].startswith("Tick 3")


def test_before_the_first_tick_there_is_nothing(history: Path) -> None:
    with pytest.raises(DataError, match="no tick is recorded before that time"):
        why(history, START_UTC, UTC)


def test_the_command_line_reads_a_database(history: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", "--history", str(history), "--at", "2026-01-01T00:02"]) == 0
    assert capsys.readouterr().out.startswith("Tick 2, ")


def test_a_missing_database_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", "--history", str(tmp_path / "none.db")]) == 2
    assert "none.db" in capsys.readouterr().err
