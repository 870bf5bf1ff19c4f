"""Parts of `edge/assistant/llm` for tests: a line that answers from a list, and all that stands on it."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.line import HttpResponse, Interrupt
from edge.config.secrets import Secret
from edge.config.settings import LlmSettings

UTC = 1_767_225_600.0
URL = "http://model.test/v1"
KEY = "sk-very-secret"
USAGE = {"prompt_tokens": 100, "completion_tokens": 20}


def settings(**values: Any) -> LlmSettings:
    return LlmSettings(**{"url": URL, "model": "m", "backoff_s": 1.0, **values})


def document(message: Mapping[str, Any], finish: str = "stop", usage: Any = USAGE) -> dict[str, Any]:
    return {"choices": [{"index": 0, "message": message, "finish_reason": finish}], "usage": usage}


def says(content: str | None, **values: Any) -> HttpResponse:
    return ok(document({"role": "assistant", "content": content}, **values))


def calls(name: str, arguments: str, id: str = "call_1") -> HttpResponse:
    call = {"id": id, "type": "function", "function": {"name": name, "arguments": arguments}}
    return ok(document({"role": "assistant", "content": None, "tool_calls": [call]}, "tool_calls"))


def ok(value: Any) -> HttpResponse:
    return HttpResponse(200, "", json.dumps(value).encode())


class ScriptedLine:
    """Answers in turn, the last one again and again; keeps what was posted. Time moves only by pauses."""

    def __init__(self, *answers: HttpResponse | LlmFailure) -> None:
        self.answers = list(answers)
        self.bodies: list[dict[str, Any]] = []
        self.headers: list[Mapping[str, str]] = []
        self.deadlines: list[float] = []
        self.pauses: list[float] = []
        self.time_s = 0.0

    def post(
        self, url: str, body: bytes, headers: Mapping[str, str], deadline_s: float, stop: Interrupt
    ) -> HttpResponse:
        assert url == URL + "/chat/completions"
        self.bodies.append(json.loads(body))
        self.headers.append(headers)
        self.deadlines.append(deadline_s)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, LlmFailure):
            raise answer
        return answer

    def pause(self, stop: Interrupt, seconds: float) -> None:
        self.pauses.append(seconds)
        self.time_s += seconds


@contextmanager
def endpoint(folder: Path, line: ScriptedLine, **values: Any) -> Iterator[Endpoint]:
    chosen = settings(**values)
    budget = Budget(chosen, Spending(""), lambda spent: None, lambda: UTC)
    yield Endpoint(chosen, budget, Secret(KEY), line.post, lambda: line.time_s, line.pause)


@contextmanager
def language_model(folder: Path, line: ScriptedLine, **values: Any) -> Iterator[LanguageModel]:
    with endpoint(folder, line, **values) as made:
        model = LanguageModel(made.settings, made, made.budget, folder / "history.db", lambda: UTC)
        yield model
        model.close()
