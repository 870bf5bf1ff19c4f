"""The language model that turns an operator's wish into the JSON object of `edge/steering/answer.py`."""

from collections.abc import Mapping
from typing import Any

from edge.llm.answer import read_object
from edge.llm.language_model import LanguageModel
from edge.llm.wire import Schema
from edge.steering.answer import SCHEMA

ANSWER_S = 120.0  # nobody waits for it but the operator


def settings_from(model: LanguageModel, messages: list[dict[str, str]]) -> Mapping[str, Any]:
    """The object that the model answered. Errors: LlmFailure"""
    reply = model.endpoint.chat(messages, schema=Schema("settings", SCHEMA), deadline_s=ANSWER_S)
    return read_object(reply.content)
