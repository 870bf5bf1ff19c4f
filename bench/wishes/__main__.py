"""python -m bench.wishes --url URL --model NAME: 100 sentences of operators, put to a language model.

The prompt, the form of the answer and its check are those of `greenhouse ask`. Right is what wishes.yaml
says, written before any model was asked. A question back or a refusal does no harm; a wrong proposal would
have to be noticed by the person who reads it, so that the text for confirmation has to show every value.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from zoneinfo import ZoneInfo

from bench.header import header
from bench.wishes.wish import Wish, WishEnd, hidden_values, read_wishes
from edge.assistant.llm.budget import Spending
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel, open_language_model
from edge.assistant.requests.answer import settings_from, understood
from edge.assistant.requests.desk import messages
from edge.assistant.requests.prediction import describe
from edge.config import loading
from edge.config.settings import Settings
from edge.core.errors import RequestError
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
VERDICTS = ("right", "ask", "refuse", "nothing", "wrong")


def put(wish: Wish, model: LanguageModel, settings: Settings) -> tuple[WishEnd, Steering | None, str]:
    """Return the end of a question, the proposal, and the reason where nothing came."""
    try:
        document = settings_from(model, messages(wish.words, STATE, settings))
    except LlmFailure as failure:
        return WishEnd.NOTHING, None, str(failure)
    try:
        found = understood(document, wish.id, wish.words, NOW, settings.reference)
    except RequestError as error:
        return WishEnd.REFUSE, None, str(error)
    if found.steering is None:
        return WishEnd.ASK, None, found.question
    return WishEnd.SETTINGS, found.steering, ""


def score(model: LanguageModel, settings: Settings, wishes: Sequence[Wish]) -> list[str]:
    """Put every wish; return a line for each that is not right, and the table."""
    lines, counts, hidden = [], Counter[tuple[str, str]](), []
    begun_s = time.monotonic()
    for wish in wishes:
        outcome, steering, reason = put(wish, model, settings)
        verdict = wish.verdict(outcome, steering, NOW)
        counts[wish.language, verdict] += 1
        counts[KINDS[wish.best is WishEnd.SETTINGS], verdict] += 1
        if steering is not None:
            text = describe(steering, ZoneInfo("UTC"))
            hidden += hidden_values(steering, text, lambda one: describe(one, ZoneInfo("UTC")))
            reason = "; ".join(wish.differences(steering, NOW)) or "nothing should have been proposed"
        if verdict != "right":
            lines.append(f"{wish.id} {verdict:<8s}{wish.words[:60]} | {reason[:150]}")
    passed_s = time.monotonic() - begun_s
    lines += table(counts)
    lines += [
        f"who always {words} would be right in {sum(end in (one.best, *one.also) for one in wishes)}"
        for words, end in (("asks back", WishEnd.ASK), ("proposes the impossible", WishEnd.REFUSE))
    ]
    lines.append(f"values that a text for confirmation does not show: {', '.join(hidden) or 'none'}")
    lines.append(
        f"{passed_s / len(wishes):.1f} s and {model.budget.spent.tokens / len(wishes):.0f} tokens a wish"
    )
    return lines


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
    given = parser.parse_args(words)
    settings = loading.default()
    print(*header(), f"model {given.model}", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        model = open_model(given.url, given.model, Path(folder), settings)
        try:
            print(*score(model, settings, read_wishes()), sep="\n")
        finally:
            model.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
