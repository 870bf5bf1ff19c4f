"""llm/proposal.py: the three architectures from question to checked proposal, over a scripted line."""

import json
from pathlib import Path
from typing import Any

import pytest
from contexts import context
from llm_parts import ScriptedLine, calls, language_model, says

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.line import HttpResponse, Interrupt
from edge.assistant.llm.proposal import Architecture, ModelProposal
from edge.core.controller_names import LLM
from edge.models.arx_file import read_arx
from edge.storage.file import connect

ARX = read_arx()
SIMULATE = calls("simulate", '{"heater_duty": [0.3, 0.2], "fan_on": [false, false]}')


def says_controls(**values: Any) -> HttpResponse:
    return says(json.dumps({"heater_duty": 0.3, "fan_on": False, "rationale": "warm", **values}))


def proposed(
    folder: Path, name: str, *answers: HttpResponse, **values: Any
) -> tuple[ModelProposal, ScriptedLine]:
    line, variant = ScriptedLine(*answers), LLM[name]
    predictor = ARX if variant.assistance not in ("", "sql") else None
    with language_model(folder, line, **values) as model:
        architecture = Architecture(variant, predictor, True, 10, False)
        return architecture.propose(model, context(temp=24.0, reference=26.0), Interrupt()), line


def kind_of(folder: Path, name: str, *answers: HttpResponse) -> str:
    with pytest.raises(LlmFailure) as caught:
        proposed(folder, name, *answers)
    return caught.value.kind


def test_the_simple_architecture_is_one_exchange(tmp_path: Path) -> None:
    proposal, line = proposed(tmp_path, "LLM-Te0", says_controls(), price_in=1.0, price_out=10.0)
    assert (proposal.command.heater_duty, proposal.command.fan_on, proposal.forecast) == (0.3, False, ())
    assert proposal.why == {
        "rationale": "warm",
        "architecture": "simple",
        "language_model": "m",
        "exchanges": 1,
        "waited_ms": 0.0,
        "tool_calls": [],
        "tokens": 120,
        "tokens_estimated": False,
        "cost": pytest.approx(3e-4),
        "claims": [],
    }
    assert "tools" not in line.bodies[0]
    assert line.bodies[0]["response_format"]["json_schema"]["schema"]["required"] == [
        *("heater_duty", "fan_on", "rationale")
    ]


def test_the_history_is_read_where_it_is_offered(tmp_path: Path) -> None:
    connect(tmp_path / "history.db", 1.0).close()
    query = calls("sql", '{"query": "SELECT * FROM v_ticks"}')
    proposal, line = proposed(tmp_path, "LLM-SQL-Te1", query, says_controls())
    assert proposal.why["tool_calls"] == [{"id": "sql-1", "query": "SELECT * FROM v_ticks", "rows": 0}]
    assert proposal.why["architecture"] == "sql"
    assert [tool["function"]["name"] for tool in line.bodies[0]["tools"]] == ["sql"]
    assert line.bodies[0]["temperature"] == 1.0


def test_a_cited_simulation_is_the_forecast(tmp_path: Path) -> None:
    proposal, _ = proposed(tmp_path, "LLM-Linear-Te0", SIMULATE, says_controls(simulation="simulate-1"))
    assert len(proposal.forecast) == 10
    assert proposal.why["simulation"] == "simulate-1"
    assert proposal.why["model"] == f"{ARX.name} {ARX.version}"
    (call,) = proposal.why["tool_calls"]
    assert (call["id"], call["heater_duty"], call["fan_on"], call["steps"]) == ("simulate-1", 0.3, False, 10)


@pytest.mark.parametrize(
    ("answers", "kind"),
    [
        ([says_controls()], "uncited"),
        ([says_controls(simulation="simulate-1")], "uncited"),
        ([SIMULATE, says_controls()], "uncited"),
        ([SIMULATE, says_controls(simulation="simulate-2")], "uncited"),
        ([SIMULATE, says_controls(simulation="simulate-1", heater_duty=0.2)], "unfaithful"),
        ([SIMULATE, says_controls(simulation="simulate-1", fan_on=True)], "unfaithful"),
        ([SIMULATE], "too_many_exchanges"),
    ],
)
def test_controls_without_a_simulation_behind_them_are_refused(
    tmp_path: Path, answers: list[HttpResponse], kind: str
) -> None:
    assert kind_of(tmp_path, "LLM-Linear-Te0-P", *answers) == kind


def test_what_became_of_questions_is_counted(tmp_path: Path) -> None:
    cited = says_controls(simulation="simulate-1")
    with language_model(tmp_path, ScriptedLine(SIMULATE, cited, says("{"))) as model:
        architecture = Architecture(LLM["LLM-Linear-Te0"], ARX, True, 10, False)
        here = context(temp=24.0, reference=26.0)
        architecture.propose(model, here, Interrupt())
        with pytest.raises(LlmFailure, match="malformed"):
            architecture.propose(model, here, Interrupt())
        counted = model.counted
    assert (counted["answered"], counted["malformed"], counted["calls"]) == (1, 1, 1)
    assert counted["exchanges"] >= 3 and counted["sent"] >= 300


def test_the_simple_architecture_cites_nothing(tmp_path: Path) -> None:
    assert kind_of(tmp_path, "LLM-Te0", says_controls(simulation="simulate-1")) == "wrong_schema"


def test_a_claim_is_flagged_and_changes_no_command(tmp_path: Path) -> None:
    proposal, _ = proposed(tmp_path, "LLM-Te0", says_controls(rationale="I have turned the fan on."))
    assert proposal.command.heater_duty == 0.3
    assert [claim.kind for claim in proposal.flagged] == ["action"]
    assert proposal.why["claims"][0]["holds"] is False


def test_a_duty_between_levels_is_told(tmp_path: Path) -> None:
    proposal, _ = proposed(tmp_path, "LLM-Te0", says_controls(heater_duty=0.33))
    assert (proposal.command.heater_duty, proposal.why["rounded_from"]) == (0.35, 0.33)


def test_the_why_is_json(tmp_path: Path) -> None:
    proposal, _ = proposed(tmp_path, "LLM-HAM-Te0", SIMULATE, says_controls(simulation="simulate-1"))
    json.dumps(dict(proposal.why), allow_nan=False)
