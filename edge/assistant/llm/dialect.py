"""Abilities of a server beyond the common part of chat completions, learnt from its refusals and answers.

Of servers that call themselves compatible, one refuses `json_schema` with status 500, one ignores tools, one
insists on another name for the length of an answer. Each difference is found once and remembered.
"""

from dataclasses import dataclass, replace
from enum import Enum

REFUSALS = (400, 404, 415, 422, 500, 501)  # statuses by which a server may refuse a part of a request


class AnswerForm(Enum):
    """The ways to hold an answer to JSON, the strictest first."""

    SCHEMA = "json_schema"  # OpenAI's
    OBJECT_BY_SCHEMA = "json_object with a schema"  # llama-cpp-python's
    OBJECT = "json_object"
    FREE = "words alone"

    @property
    def looser(self) -> "AnswerForm | None":
        """The next one to try."""
        forms = list(AnswerForm)
        place = forms.index(self) + 1
        return forms[place] if place < len(forms) else None


@dataclass(frozen=True, slots=True)
class Dialect:
    """A way to ask.

    tokens_key : newer models of OpenAI's insist on max_completion_tokens
    native_tools : the server speaks of tools by itself; else the prompt carries them
    """

    form: AnswerForm = AnswerForm.SCHEMA
    tokens_key: str = "max_tokens"
    native_tools: bool = True

    def after_refusal(self, said: str, has_tools: bool) -> "Dialect | None":
        """Return the next dialect to try after a refusal with this text, None when none is left."""
        if "max_completion_tokens" in said and self.tokens_key == "max_tokens":
            return replace(self, tokens_key="max_completion_tokens")
        if has_tools and self.native_tools:
            return replace(self, native_tools=False)
        looser = self.form.looser
        return None if looser is None else replace(self, form=looser)
