"""The language model that turns an operator's wish into the JSON object of `answer.py`."""

from collections.abc import Mapping
from typing import Any

from edge.assistant.llm.answer import read_object
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.wire import Schema
from edge.assistant.requests.answer import SCHEMA

ANSWER_S = 120.0  # nobody waits for it but the operator


def settings_from(model: LanguageModel, messages: list[dict[str, str]]) -> Mapping[str, Any]:
    """Return the object in the model's answer. Errors: LlmFailure"""
    reply = model.endpoint.chat(messages, schema=Schema("settings", SCHEMA), deadline_s=ANSWER_S)
    return read_object(reply.content)
