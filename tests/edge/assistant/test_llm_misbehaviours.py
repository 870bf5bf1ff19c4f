"""Every misbehaviour of a server or a model through the whole daemon on the virtual board.

One run per architecture, in which the stand-in behaves otherwise every two ticks. The rig stays inside its
limits and near its reference, because the fallback decides, and the history says why.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import pytest

from edge.core.messages import TickRecord
from tests.support.llm_closed_loop import REFERENCE_C, YAML, RunRemains, run
from training.lab import Lab
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow

TICKS = 2  # per misbehaviour
WARM_UP = 12  # ticks of honest answers before the first
HASTY = YAML.replace("decision_deadline_s: 1.0", "decision_deadline_s: 0.2")
FAILS = {  # what the history calls it
    "LLM-Te0": {
        "429": "rate_limited: status 429",
        "500": "server_error: status 500",
        "401": "refused_key: status 401",
        "cut": "unreachable: the line failed",
        "broken_json": "malformed: the reply: not JSON",
        "broken_answer": "malformed: the answer: not JSON",
        "wrong_schema": "wrong_schema: unknown key 'heater'; did you mean 'heater_duty'?",
        "out_of_range": "out_of_range: heater_duty is 40, not 0 to 1",
        "truncated": "truncated: ",
        "refusal": "refusal: the model refuses: I can't help with heating.",
        "filtered": "refusal: a content filter",
        "endless_reply": "malformed: the reply is longer",
        "hanging": "timeout: no whole reply within 0.3 s",
        "dripping": "timeout: no whole reply within 0.3 s",
    },
    "LLM-SQL-Te0": {
        "unknown_tool": "unknown_tool: 'turn_heater_on', again after it was told",
        "endless_tools": "too_many_exchanges: no answer after 8",
    },
    "LLM-Linear-Te0": {
        "bad_arguments": "malformed: simulate: arguments: not JSON",
        "unfaithful": "unfaithful: simulate-",
        "invented_result": "uncited: the answer cites 'simulate-1', which is no simulation it asked for",
        "unknown_tool": "unknown_tool: ",
    },
}


@dataclass(frozen=True, slots=True)
class MisbehaviourRun:
    """One run, and the ticks at which each misbehaviour was answered."""

    ended: RunRemains
    ticks: Mapping[str, range]

    def decided(self, behave: str) -> list[str]:
        return [self.ended.records[tick].decision.controller for tick in self.ticks[behave]]

    def errors(self, behave: str) -> list[str]:
        """Texts of what the controller raised meanwhile, as the records have them."""
        return [
            event.text
            for tick in self.ticks[behave]
            for event in self.ended.records[tick].events
            if event.key == "controller.error"
        ]


def trial(controller: str, behaviours: Sequence[str]) -> MisbehaviourRun:
    ticks = {name: range(WARM_UP + TICKS * n, WARM_UP + TICKS * (n + 1)) for n, name in enumerate(behaviours)}
    by_tick = ["honest"] * WARM_UP + [name for name in behaviours for _ in range(TICKS)]
    with StandIn() as stand_in:

        def turn(record: TickRecord, lab: Lab) -> None:
            stand_in.behave = by_tick[min(len(records) + 1, len(by_tick) - 1)]
            records.append(record)

        records: list[TickRecord] = []
        return MisbehaviourRun(run(controller, stand_in.url, len(by_tick), during=turn, timeout_s=0.3), ticks)


@pytest.fixture(scope="module")
def trials() -> dict[str, MisbehaviourRun]:
    return {controller: trial(controller, list(fails)) for controller, fails in FAILS.items()}


CASES = [(controller, behave) for controller, fails in FAILS.items() for behave in fails]


@pytest.mark.parametrize(("controller", "behave"), CASES)
def test_the_fallback_decides_and_the_history_says_why(
    trials: dict[str, MisbehaviourRun], controller: str, behave: str
) -> None:
    there = trials[controller]
    # On a busy machine the fallback too may miss its deadline; behind it stand the rules.
    assert set(there.decided(behave)) <= {"MPC", "rules"}
    wanted = f"{controller}: LlmFailure: {FAILS[controller][behave]}"
    assert [text for text in there.errors(behave) if text.startswith(wanted)], there.errors(behave)
    stored = there.ended.texts("controller.error")
    assert [text for text in stored if text.startswith(wanted)]


@pytest.mark.parametrize("controller", FAILS)
def test_the_rig_stays_near_its_reference_and_inside_its_limits(
    trials: dict[str, MisbehaviourRun], controller: str
) -> None:
    ended = trials[controller].ended
    assert np.abs(ended.true_air_c[WARM_UP:] - REFERENCE_C).max() < 1.5  # the sensor alone reads 0.4 K high
    assert ended.error_k < 1.0
    assert all(record.echo is not None for record in ended.records)


@pytest.mark.parametrize("controller", FAILS)
def test_failures_are_counted_by_kind(trials: dict[str, MisbehaviourRun], controller: str) -> None:
    last = trials[controller].ended.texts("controller.error")[-1]
    assert "(so far: " in last
    counted = sum(int(part.split()[-1]) for part in last.split("(so far: ")[1].rstrip(")").split(", "))
    assert counted == len(trials[controller].ended.texts("controller.error"))


def test_a_slow_model_is_late_and_the_tick_goes_on() -> None:
    with StandIn("slow") as stand_in:
        ended = run("LLM-Te0", stand_in.url, 12, HASTY)
    # On a busy machine the fallback too may miss so short a deadline; behind it stand the rules.
    assert {record.decision.controller for record in ended.records} <= {"MPC", "rules"}
    assert ended.texts("controller.error")[0].startswith("LLM-Te0: LlmFailure: late: no answer within 0.17 s")
    assert max(record.decide_ms for record in ended.records) < 4000.0


def test_a_model_that_boasts_or_invents_is_flagged_and_changes_nothing_by_it() -> None:
    behaviours = cycle(("boasting", "invented_result"))
    with StandIn("boasting") as stand_in:

        def turn(record: TickRecord, lab: Lab) -> None:
            stand_in.behave = next(behaviours)

        ended = run("LLM-Te0", stand_in.url, 10, during=turn)
    flags = ended.texts("llm.claim")
    assert any("'I have turned the fan on.' (it can only propose" in text for text in flags)
    assert any("26.00 degC: no simulation was asked for" in text for text in flags)
    assert not any(record.echo and record.echo.fan_on for record in ended.records)
    claims = [claim for why in ended.whys for claim in why.get("claims", ())]
    assert any(not claim["holds"] for claim in claims)


def test_a_budget_that_is_spent_sends_nothing_more() -> None:
    with StandIn() as stand_in:
        ended = run("LLM-Te0", stand_in.url, 12, tokens_per_day=4000)
        sent = len(stand_in.requests)
    assert 0 < sent < 12
    assert [record.decision.controller for record in ended.records] == ["LLM-Te0"] * sent + ["MPC"] * (
        12 - sent
    )
    assert "over_budget: " in ended.texts("controller.error")[0]


def test_a_server_without_response_format_serves_all_the_same() -> None:
    with StandIn("no_response_format") as stand_in:
        ended = run("LLM-Te0", stand_in.url, 4)
        assert len(stand_in.requests) == 7  # refused in three forms, then known
    assert {record.decision.controller for record in ended.records} == {"LLM-Te0"}
