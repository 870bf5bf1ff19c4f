"""python -m bench.wishes --url URL --model NAME: 100 sentences of operators, put to a language model.

The prompt, the form of the answer and its check are those of `greenhouse ask`. Right is what wishes.yaml
says, written before any model was asked. A question back or a refusal does no harm; a wrong proposal would
have to be noticed by the person who reads it, so that the text for confirmation has to show every value.

With --memory the sentences are the 32 of remembered.yaml, each put twice: without its facts, and with them in
the data block that the desk would give.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from bench.header import header
from bench.wishes.wish import REMEMBERED, Wish, WishEnd, hidden_values, read_wishes
from edge.assistant.llm.budget import Spending
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel, open_language_model
from edge.assistant.requests.answer import settings_from, understood
from edge.assistant.requests.desk import messages
from edge.assistant.requests.memory import Decided, memory_block
from edge.assistant.requests.prediction import describe
from edge.config import loading
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.storage.facts import FactBook, FactKind
from edge.storage.file import connect
from edge.tick.steering import Steering

NOW = datetime(2026, 3, 4, 10, 0, tzinfo=UTC).timestamp()
STATE = {
    "local_time_s_of_day": 36000,
    "temp_air_c": 23.8,
    "temp_ambient_c": 21.0,
    "reference_c": 24.0,
    "controller": "MPC-Twin-P",
}
KINDS = ("wants no settings", "wants settings")
NO_SETTINGS: Mapping[str, Any] = {
    **dict.fromkeys(("heater_penalty", "fan_penalty", "heater_max_duty")),
    **dict.fromkeys(("reference", "fan_rest"), ()),
    "hours": 24,
    "understood": "",
    "question": "",
}
VERDICTS = ("right", "ask", "refuse", "nothing", "wrong")


def put(
    wish: Wish, memory: str, model: LanguageModel, settings: Settings
) -> tuple[WishEnd, Steering | None, str]:
    """Return the end of a question, the proposal, and the reason where nothing came."""
    try:
        document = settings_from(model, messages(wish.words, STATE, settings, memory))
    except LlmFailure as failure:
        return WishEnd.NOTHING, None, str(failure)
    try:
        found = understood(document, wish.id, wish.words, NOW, settings.reference)
    except RequestError as error:
        return WishEnd.REFUSE, None, str(error)
    if found.steering is None:
        return WishEnd.ASK, None, found.question
    return WishEnd.SETTINGS, found.steering, ""


def memory_of(wish: Wish, history: Path, settings: Settings) -> str:
    """Return the data block that the desk would give; its facts are written to a new file `history`."""
    connect(history, 1.0).close()
    for number, fact in enumerate(wish.facts):
        book = FactBook(history, partial(float, fact.utc))
        if fact.kind is FactKind.NOTE:
            book.note(fact.text, fact.by)
        else:
            id, given = f"p{number}", {**NO_SETTINGS, **fact.settings}
            steering = understood(given, id, fact.words, fact.utc, settings.reference).steering
            assert steering is not None
            changes = describe(steering, UTC)
            book.decide(fact.kind, id, Decided(fact.kind, id, fact.words, changes, fact.why).text, fact.by)
        if fact.erased:
            book.forget(max(each.id for each in book.newest_first()))
    return memory_block(book.newest_first(), wish.words, settings.llm.memory_tokens, NOW, UTC)


def score(
    model: LanguageModel,
    settings: Settings,
    wishes: Sequence[Wish],
    memory: Mapping[str, str] | None = None,
    jobs: int = 1,
) -> list[str]:
    """Put every wish, `jobs` at a time; return a line for each that is not right, and the table.

    memory : blocks by id
    """
    lines, counts, hidden = [], Counter[tuple[str, str]](), []
    begun_s, spent = time.monotonic(), model.budget.spent.tokens
    blocks = [(memory or {}).get(wish.id, "") for wish in wishes]
    with ThreadPoolExecutor(jobs) as pool:
        ends = list(pool.map(partial(put, model=model, settings=settings), wishes, blocks))
    for wish, (outcome, steering, reason) in zip(wishes, ends, strict=True):
        verdict = wish.verdict(outcome, steering, NOW)
        counts[wish.language, verdict] += 1
        counts[KINDS[wish.best is WishEnd.SETTINGS], verdict] += 1
        if steering is not None:
            text = describe(steering, ZoneInfo("UTC"))
            hidden += hidden_values(steering, text, lambda one: describe(one, ZoneInfo("UTC")))
            reason = "; ".join(wish.differences(steering, NOW)) or "nothing should have been proposed"
        if verdict != "right":
            lines.append(f"{wish.id} {verdict:<8s}{wish.words[:60]} | {reason[:150]}")
    passed_s, tokens = time.monotonic() - begun_s, model.budget.spent.tokens - spent
    lines += table(counts)
    lines += [
        f"who always {words} would be right in {sum(end in (one.best, *one.also) for one in wishes)}"
        for words, end in (("asks back", WishEnd.ASK), ("proposes the impossible", WishEnd.REFUSE))
    ]
    lines.append(f"values that a text for confirmation does not show: {', '.join(hidden) or 'none'}")
    lines.append(f"{passed_s / len(wishes):.1f} s and {tokens / len(wishes):.0f} tokens a wish")
    return lines


def compare(
    model: LanguageModel, settings: Settings, wishes: Sequence[Wish], folder: Path, jobs: int = 1
) -> Iterator[str]:
    """Yield the score without and with what each wish refers to."""
    blocks = {wish.id: memory_of(wish, folder / f"{wish.id}.db", settings) for wish in wishes}
    yield "without memory"
    yield from score(model, settings, wishes, None, jobs)
    yield f"with memory, at most {settings.llm.memory_tokens} tokens"
    yield from score(model, settings, wishes, blocks, jobs)


def table(counts: Counter[tuple[str, str]]) -> list[str]:
    """Return verdicts by language, and by whether settings are wanted."""
    lines = [f"{'':18s}" + "".join(f"{verdict:>9s}" for verdict in VERDICTS)]
    for name in dict.fromkeys(name for name, _ in counts):
        lines.append(f"{name:18s}" + "".join(f"{counts[name, verdict]:9d}" for verdict in VERDICTS))
    return lines


def open_model(url: str, name: str, folder: Path, settings: Settings) -> LanguageModel:
    """Return the model behind an endpoint; a small computer may take its time."""
    llm = replace(settings.llm, url=url, model=name, timeout_s=110.0, answer_tokens=500, retries=0)
    return open_language_model(llm, folder / "none.db", Spending(""), lambda spent: None, time.time)


def main(words: Sequence[str] | None = None) -> int:
    """Score and print."""
    parser = argparse.ArgumentParser(prog="python -m bench.wishes", description=__doc__)
    parser.add_argument("--url", required=True, help="base URL of an OpenAI-compatible endpoint")
    parser.add_argument("--model", required=True, help="its name there")
    parser.add_argument("--memory", action="store_true", help="the wishes that refer to earlier ones")
    parser.add_argument("--jobs", type=int, default=1, help="wishes put at a time; default: 1")
    given = parser.parse_args(words)
    settings = loading.default()
    print(*header(), f"model {given.model}", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        model = open_model(given.url, given.model, Path(folder), settings)
        try:
            if given.memory:
                lines = compare(model, settings, read_wishes(REMEMBERED), Path(folder), given.jobs)
            else:
                lines = iter(score(model, settings, read_wishes(), None, given.jobs))
            for line in lines:
                print(line, flush=True)
        finally:
            model.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
