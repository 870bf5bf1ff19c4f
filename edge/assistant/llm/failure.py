"""Why a language model gave nothing that can be used: one exception, a kind and a text."""

from edge.core.errors import GreenhouseError

KINDS = (
    "unreachable",  # no connection, or it broke
    "timeout",  # not all of the answer came in time
    "rate_limited",  # 429
    "server_error",  # 5xx
    "refused_key",  # 401, 403
    "bad_request",  # another 4xx, or a redirect
    "malformed",  # no JSON, or not of the wire format
    "truncated",  # finish_reason length
    "refusal",  # the model's or a content filter's
    "wrong_schema",  # JSON, but not the answer that was asked for
    "out_of_range",  # a control that the rig does not have
    "unknown_tool",
    "too_many_exchanges",
    "over_budget",
    "uncited",  # no simulation stands behind the controls
    "unfaithful",  # the simulation cited is not one of these controls
    "late",  # not there when the tick had to go on
    "interrupted",  # nobody waits for it any more
    "broken",  # a part of ours raised
    "unequipped",  # a model or file that the architecture needs is not there
)


class LlmFailure(GreenhouseError):
    """No usable answer; `kind` is one of KINDS, the text is fit for the history and holds no secret."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}")
        self.kind = kind
        self.text = text
