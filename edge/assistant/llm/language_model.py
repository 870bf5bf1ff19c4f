"""The language model of a rig: what all who ask it share. The daemon makes it and closes it."""

import queue
import ssl
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.line import Interrupt, Post, post
from edge.config.secrets import read_secret
from edge.config.settings import LlmSettings
from edge.core.errors import ConfigError
from edge.core.messages import Event

T = TypeVar("T")
END_S = 2.0  # how long the end of a thread is waited for; one that hangs is a daemon thread


class Question(Generic[T]):
    """Under way from its making on.

    work : gives the answer or raises, and ends soon after its interrupt is fired
    asked_s : the asker's time [s]
    """

    def __init__(self, work: Callable[[Interrupt], T], asked_s: float) -> None:
        self.asked_s = asked_s
        self._work = work
        self._stop = Interrupt()
        self._done = threading.Event()
        self._answer: T | None = None
        self._failure: LlmFailure | None = None
        self._thread = threading.Thread(target=self._run, name="language-model", daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """Wait at most so long; return whether the question is over."""
        return self._done.wait(seconds)

    def answer(self) -> T:
        """Return the answer of a question that is over. Errors: LlmFailure"""
        if self._failure is not None:
            raise self._failure
        assert self._answer is not None
        return self._answer

    def drop(self) -> None:
        """Nobody wants the answer any more. Does not wait."""
        self._stop.fire()

    def close(self) -> None:
        """Drop it, and see its thread end."""
        self.drop()
        self._thread.join(END_S)

    def _run(self) -> None:
        try:
            self._answer = self._work(self._stop)
        except LlmFailure as failure:
            self._failure = failure
        except Exception as error:  # of any part of the work; the asker's fallback decides then
            self._failure = LlmFailure("broken", f"{type(error).__name__}: {error}")
        finally:
            self._stop.let_go()
            self._done.set()


@dataclass(slots=True)
class LanguageModel:
    """Endpoint, budget, the history it may read, and what is to be told of it.

    counted : since its making, of the questions of controllers: their ends ("answered" or a kind of failure),
        and the sums of `Conversation.counts`
    """

    settings: LlmSettings
    endpoint: Endpoint
    budget: Budget
    history: Path
    utc: Callable[[], float]
    _events: "queue.SimpleQueue[Event]" = field(default_factory=queue.SimpleQueue)
    counted: Counter[str] = field(default_factory=Counter)
    _questions: list[Question[Any]] = field(default_factory=list)
    _counting: threading.Lock = field(default_factory=threading.Lock)

    def count(self, counts: Mapping[str, int]) -> None:
        """Add to `counted`; from any thread."""
        with self._counting:
            self.counted.update(counts)

    def tell(self, event: Event) -> None:
        """Into the next record; from any thread."""
        self._events.put(event)

    def events_pending(self) -> list[Event]:
        """Return the events since the last call."""
        return [self._events.get_nowait() for _ in range(self._events.qsize())]

    def under_way(self, question: Question[Any]) -> None:
        """See to the end of a question at `close`."""
        self._questions = [each for each in self._questions if not each.wait(0.0)]
        self._questions.append(question)

    def wait(self, seconds: float) -> None:
        """Wait for what is under way, each question at most so long."""
        for question in self._questions:
            question.wait(seconds)

    def close(self) -> None:
        """Drop what is under way."""
        for question in self._questions:
            question.close()


def open_language_model(
    settings: LlmSettings,
    history: Path,
    spent: Spending,
    save: Callable[[Spending], None],
    utc: Callable[[], float],
) -> LanguageModel:
    """Errors: ConfigError when the key or the authority's certificate can't be read."""
    key = read_secret(settings.key_file, "llm.key_file") if settings.key_file else None
    budget = Budget(settings, spent, save, utc)
    return LanguageModel(settings, Endpoint(settings, budget, key, open_line(settings)), budget, history, utc)


def open_line(settings: LlmSettings) -> Post:
    """How its server is asked. Errors: ConfigError when the authority's certificate can't be read."""
    if not settings.ca:
        return post
    try:
        ssl.create_default_context(cafile=settings.ca)
    except OSError as error:
        raise ConfigError(f"llm.ca: {settings.ca}: {error.strerror or error}") from None
    return partial(post, ca=settings.ca)
