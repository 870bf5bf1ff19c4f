"""edge/assistant/llm/budget.py: a day's tokens and money, over restarts and for failed exchanges too."""

import contextlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from llm_parts import UTC, ScriptedLine, endpoint, says, settings

from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.line import HttpResponse
from edge.assistant.llm.wire import Usage
from edge.config.loading import default
from edge.state.store import LLM_BUDGET, restore
from edge.state.writer import StateWriter

HELLO = [{"role": "user", "content": "hello"}]
DAY_S = 86400.0


class Days:
    """A budget that is restored from one file and saved to it, and the wall clock it goes by."""

    def __init__(self, folder: Path, **values: Any) -> None:
        self.utc = UTC
        place = replace(default(), state_file=str(folder / "state.json"))
        self.writer = StateWriter(LLM_BUDGET, place)
        spent = restore(LLM_BUDGET, place)
        self.budget = Budget(settings(**values), spent, self.writer.save, lambda: self.utc)

    def spend(self, most: Usage, used: Usage) -> None:
        self.budget.charge(most)
        self.budget.settle(most, used)


@pytest.fixture
def days(tmp_path: Path):
    made = Days(tmp_path, tokens_per_day=1000, price_in=2.0, price_out=10.0)
    yield made
    made.writer.close()


def test_what_was_used_counts_and_not_what_was_feared(days: Days) -> None:
    days.spend(Usage(100, 800), Usage(90, 20))
    spent = days.budget.spent
    assert (spent.tokens, spent.exchanges) == (110, 1)
    assert spent.cost == pytest.approx(90 * 2e-6 + 20 * 1e-5)


@pytest.mark.parametrize(("sent", "fits"), [(199, True), (200, True), (201, False)])
def test_nothing_is_sent_that_could_go_over_the_day(days: Days, sent: int, fits: bool) -> None:
    most = Usage(sent, 800)
    if fits:
        days.budget.charge(most)
    else:
        with pytest.raises(LlmFailure, match="over_budget: 0 of 1000 tokens"):
            days.budget.charge(most)


def test_two_who_ask_at_once_cannot_spend_the_same_tokens(days: Days) -> None:
    days.budget.charge(Usage(0, 600))
    with pytest.raises(LlmFailure, match="over_budget"):
        days.budget.charge(Usage(0, 600))


def test_money_is_a_limit_too(tmp_path: Path) -> None:
    days = Days(tmp_path, tokens_per_day=0, cost_per_day=0.01, price_out=10.0)
    days.spend(Usage(0, 900), Usage(0, 900))
    with pytest.raises(LlmFailure, match="over_budget"):
        days.budget.charge(Usage(0, 101))
    days.writer.close()


def test_a_new_utc_day_begins_at_nothing(days: Days) -> None:
    days.spend(Usage(900, 0), Usage(900, 0))
    days.utc += DAY_S - 1.0
    assert days.budget.spent.tokens == 900
    days.utc += 1.0
    assert days.budget.spent.tokens == 0
    days.budget.charge(Usage(900, 0))


def test_an_exchange_over_midnight_leaves_no_credit(days: Days) -> None:
    days.budget.charge(Usage(500, 0))
    days.utc += DAY_S
    days.budget.settle(Usage(500, 0), Usage())
    assert days.budget.spent.tokens == 0


def test_a_restart_goes_on_where_it_was(days: Days, tmp_path: Path) -> None:
    days.spend(Usage(900, 0), Usage(900, 0))
    days.writer.close()
    again = Days(tmp_path, tokens_per_day=1000)
    assert again.budget.spent.tokens == 900
    again.writer.close()


def test_a_spoilt_file_is_a_new_day(tmp_path: Path) -> None:
    (tmp_path / "llm_budget.json").write_text(
        '{"day": "2026-01-01", "tokens": -5, "cost": 0, "exchanges": 0}'
    )
    assert restore(LLM_BUDGET, replace(default(), state_file=str(tmp_path / "state.json"))) == Spending("")


@pytest.mark.parametrize(
    ("answer", "tokens"),
    [
        (says("hi"), 120),
        (says("hi", finish="length"), 120),
        (
            HttpResponse(
                500, "", json.dumps({"usage": {"prompt_tokens": 7, "completion_tokens": 0}}).encode()
            ),
            7,
        ),
        (HttpResponse(500, "", b"no"), 0),
        (LlmFailure("unreachable", "x"), 0),
    ],
)
def test_failed_exchanges_cost_what_the_server_counted(
    tmp_path: Path, answer: HttpResponse | LlmFailure, tokens: int
) -> None:
    with endpoint(tmp_path, ScriptedLine(answer), retries=0) as made:
        with contextlib.suppress(LlmFailure):
            made.chat(HELLO)
        assert made.budget.spent.tokens == tokens


@pytest.mark.parametrize(
    "answer", [says("hi", usage=None), LlmFailure("timeout", "x"), HttpResponse(200, "", b"{")]
)
def test_what_nobody_counted_is_estimated(tmp_path: Path, answer: HttpResponse | LlmFailure) -> None:
    with endpoint(tmp_path, ScriptedLine(answer)) as made:
        with contextlib.suppress(LlmFailure):
            assert made.chat(HELLO).usage.estimated
        assert 20 < made.budget.spent.tokens < 200  # four characters a token


def test_over_budget_nothing_goes_over_the_line(tmp_path: Path) -> None:
    line = ScriptedLine(says("hi"))
    with endpoint(tmp_path, line, tokens_per_day=700) as made, pytest.raises(LlmFailure, match="over_budget"):
        made.chat(HELLO)
    assert line.bodies == []


@given(st.lists(st.tuples(*[st.integers(0, 2000)] * 4), max_size=8))
def test_a_day_never_goes_over_what_servers_keep_to(tmp_path_factory, exchanges) -> None:
    days = Days(tmp_path_factory.mktemp("budget"), tokens_per_day=3000)
    for sent, received, less_sent, less_received in exchanges:
        most = Usage(sent, received)
        with contextlib.suppress(LlmFailure):
            days.spend(most, Usage(min(sent, less_sent), min(received, less_received)))
        assert 0 <= days.budget.spent.tokens <= 3000
        assert math.isfinite(days.budget.spent.cost)
    days.writer.close()
