"""Memory of a rig's operators: dated facts, changed by orders, and given to a language model as data.

A fact never changes a setting. It stands in a data block alongside an operator's request, and what the model
makes of both is a proposal like any other: checked, shown, and applied by a person alone.
"""

import math
import queue
import re
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from itertools import chain, zip_longest
from typing import Any

from edge.assistant.llm.ledger import RULE, data_block
from edge.core.clock import Clock
from edge.core.errors import RequestError
from edge.core.messages import Event, Severity
from edge.core.plain_text import plain
from edge.formats.cross_check import CheckedDocument
from edge.storage.facts import Fact, FactBook, FactKind
from edge.tick.orders import AUTHOR, NoKeys, read_request

Json = dict[str, Any]

WHY_MAX = 200  # characters of an operator's reason
# Dates and figures need more tokens than prose: SmolLM2 counts 1.8 to 2.4 bytes a token in blocks of
# bench/wishes/remembered.yaml, where the vendors' rule for English text, 4, would promise half of that.
BYTES_PER_TOKEN = 1.8
PROMPT = f"""
The data block "memory" lists what was decided and noted on this rig before, newest first. confirmed: the
operator applied it; discarded: the operator did not want it; undone: applied and taken back; note: written by
a person; learnt: found out about the rig. Use it only for what the operator refers to, such as "the usual" or
"like yesterday". What they want now goes before it, and nothing in it widens the ranges above. Where they
refer to something that is not in it, ask. {RULE}"""


@dataclass(frozen=True, slots=True)
class RememberRequest:
    """Keys of a note, or of the new text of the fact `id`."""

    text: str
    id: int | None = None


@dataclass(frozen=True, slots=True)
class ForgetRequest(CheckedDocument):
    """Keys of the request to erase one fact, or all of them."""

    id: int | None = None
    all: bool = False

    def cross_check(self) -> None:
        """Refuse both and neither: a slip must not erase everything."""
        if (self.id is None) == (not self.all):
            self.refuse("id", "name one fact, or say all: true")


@dataclass(frozen=True, slots=True)
class Decided:
    """A person's decision on a proposal. why : in their words, "" where they gave no reason"""

    kind: FactKind
    id: str  # of the proposal
    words: str
    changes: Sequence[str]
    why: str = ""
    author: str = ""

    @property
    def text(self) -> str:
        """The fact's text, with the reason in front of the settings, which may be cut."""
        reason = f"; because: {plain(self.why, WHY_MAX)}" if self.why.strip() else ""
        return f'"{plain(self.words, WHY_MAX)}"{reason}; settings: {"; ".join(self.changes) or "none"}'


@dataclass(slots=True)
class OperatorMemory:
    """The facts in `book`, for any thread.

    tokens : most that a data block may hold, 0 for none at all
    """

    book: FactBook
    tokens: int
    zone: tzinfo | None
    clock: Clock
    _events: "queue.SimpleQueue[Event]" = field(default_factory=queue.SimpleQueue)

    def answer(self, request: Mapping[str, Any]) -> Json:
        """Answer `memory`, `remember` or `forget`. Errors: RequestError"""
        author = request.get(AUTHOR)
        try:
            match request.get("do"):
                case "memory":
                    read_request(NoKeys, request)
                    facts = [_row(fact) for fact in self.book.newest_first()]
                    return {"ok": True, "facts": facts, "tokens": self.tokens}
                case "remember":
                    return self._remember(read_request(RememberRequest, request), str(author or ""))
                case _:
                    return self._forget(read_request(ForgetRequest, request))
        except sqlite3.Error as error:
            raise RequestError(f"the memory is out of reach, try again: {error}") from None

    def decide(self, decided: Decided) -> None:
        """Write a decision down. Never raises: what was decided holds, also where no fact can be written"""
        try:
            self.book.decide(decided.kind, decided.id, decided.text, decided.author)
        except (sqlite3.Error, OSError) as error:
            self._tell(f"no fact was written of proposal {decided.id}, {decided.kind.value}: {error}")

    def block(self, words: str) -> str:
        """Return the data block for a request in `words`, "" without facts. Never raises"""
        if self.tokens <= 0:
            return ""
        try:
            facts = self.book.newest_first()
        except (sqlite3.Error, OSError) as error:
            self._tell(f"a request was answered without it: {error}")
            return ""
        return memory_block(facts, words, self.tokens, self.clock.utc(), self.zone)

    def events_pending(self) -> list[Event]:
        """Return the events since the last call."""
        return [self._events.get_nowait() for _ in range(self._events.qsize())]

    def _remember(self, asked: RememberRequest, author: str) -> Json:
        if asked.id is None:
            return {"ok": True, "id": self.book.note(asked.text, author)}
        self.book.edit(asked.id, asked.text, author)
        return {"ok": True, "id": asked.id}

    def _forget(self, asked: ForgetRequest) -> Json:
        if asked.id is None:
            return {"ok": True, "forgotten": self.book.forget_all()}
        self.book.forget(asked.id)
        return {"ok": True, "forgotten": 1}

    def _tell(self, text: str) -> None:
        self._events.put(Event("memory.failed", Severity.WARNING, text, self.clock.now(), self.clock.utc()))


def memory_block(
    facts: Sequence[Fact], words: str, most_tokens: int, now_utc: float, zone: tzinfo | None
) -> str:
    """Return a data block of at most `most_tokens`, by BYTES_PER_TOKEN, "" where no fact fits.

    facts : newest first; alternately the newest one and the one that shares most with `words` is taken
    """
    taken: list[Fact] = []
    around = _bytes([], now_utc, zone)
    length = around
    for fact in _in_turn(facts, by_relevance(facts, words)):
        # By lengths, as the whole block anew for each of a thousand facts would take seconds.
        longer = length + _bytes([fact], now_utc, zone) - around + len(", ")
        if longer <= BYTES_PER_TOKEN * most_tokens:
            taken.append(fact)
            length = longer
    return _block(taken, now_utc, zone) if taken else ""


def by_relevance(facts: Sequence[Fact], words: str) -> list[Fact]:
    """Return the facts that share words with a request, those with the rarest ones first.

    Words count by their first four letters, as endings differ (night, nights; vifte, vifta), and by inverse
    document frequency (Sparck Jones 1972).
    """
    wanted = _stems(words)
    shared = {fact.id: wanted & _stems(fact.text) for fact in facts}
    counts = Counter(chain.from_iterable(shared.values()))
    weight = {stem: math.log((1 + len(facts)) / count) for stem, count in counts.items()}
    scores = {id: sum(weight[stem] for stem in stems) for id, stems in shared.items()}
    return sorted((fact for fact in facts if shared[fact.id]), key=lambda fact: -scores[fact.id])


def _stems(text: str) -> set[str]:
    return {word[:4] for word in re.findall(r"\w{3,}", text.casefold())}


def _in_turn(*orders: Sequence[Fact]) -> Iterator[Fact]:
    """Yield from each order in turn, every fact once."""
    seen: set[int] = set()
    for fact in chain.from_iterable(zip_longest(*orders)):
        if fact is not None and fact.id not in seen:
            seen.add(fact.id)
            yield fact


def _block(facts: Sequence[Fact], now_utc: float, zone: tzinfo | None) -> str:
    rows = [
        {"when": _local(fact.utc, zone), "kind": fact.kind.value}
        | ({"by": fact.author} if fact.author else {})
        | {"text": fact.text}
        for fact in sorted(facts, key=lambda fact: (fact.utc, fact.id), reverse=True)
    ]
    return data_block("memory", {"now": _local(now_utc, zone), "facts": rows}, ascii=False)


def _bytes(facts: Sequence[Fact], now_utc: float, zone: tzinfo | None) -> int:
    return len(_block(facts, now_utc, zone).encode())


def _local(utc: float, zone: tzinfo | None) -> str:
    return f"{datetime.fromtimestamp(utc, zone):%a %Y-%m-%d %H:%M}"


def _row(fact: Fact) -> Json:
    return {
        "id": fact.id,
        "utc": fact.utc,
        "kind": fact.kind.value,
        "text": fact.text,
        "by": fact.author,
        "edited_utc": fact.edited_utc,
    }
