"""Any OpenAI-compatible `/chat/completions`: one exchange, with retries, a deadline and a budget."""

import base64
import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from edge.assistant.llm.budget import Budget
from edge.assistant.llm.dialect import REFUSALS, Dialect
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.line import HttpResponse, Interrupt, Post, post
from edge.assistant.llm.prompted_tools import read_call, without_native_tools
from edge.assistant.llm.wire import (
    Chat,
    Message,
    Reply,
    Schema,
    ToolSpec,
    Turn,
    Usage,
    estimated_tokens,
    read_document,
    read_object,
    read_reply,
    read_usage,
    to_bytes,
)
from edge.config.secrets import Secret
from edge.config.settings import LlmSettings
from edge.core.plain_text import plain

MASK = "***"
SECRET_MIN = 8  # a shorter key is a placeholder such as "none": masking it would spoil answers [characters]
PADDINGS = range(3)  # base64 packs three bytes: the key looks different at each place in a longer text
_URLSAFE = str.maketrans("+/", "-_")


def key_pattern(key: str) -> re.Pattern[str] | None:
    """Return the pattern of every text that reveals `key`, None for a key that is not a secret.

    Found are the key itself, its hex digits and its base64 (the usual and the URL-safe alphabet, alone and
    inside a longer text such as "Bearer ..."), each also escaped as JSON or URLs escape, however often.
    """
    if len(key) < SECRET_MIN:
        return None
    raw = key.encode()
    encoded = [base64_inside(raw, padding) for padding in PADDINGS]
    forms = [key, *encoded, *(form.translate(_URLSAFE) for form in encoded)]
    patterns = ["".join(_letter(letter) for letter in form) for form in dict.fromkeys(forms)]
    separator = f"(?:{_letter(' ')}|{_letter(':')})?"
    digits = separator.join("".join(map(_hex_digit, pair)) for pair in raw.hex(" ").split())
    return re.compile("|".join([*patterns, digits]))


def base64_inside(raw: bytes, padding: int) -> str:
    """Return the base64 characters that `raw` alone decides where `padding`
    bytes (modulo 3) stand before it.
    """
    encoded = base64.b64encode(b"\0" * padding + raw).decode().rstrip("=")
    return encoded[-(-padding * 8 // 6) : (padding + len(raw)) * 8 // 6]


def _letter(letter: str) -> str:
    """Return a pattern of a letter and of its escapes in JSON (at any depth of quoting) and in URLs."""
    code = ord(letter)
    url = "".join(f"%(?:25){{0,4}}{byte:02x}" for byte in letter.encode())
    return rf"(?:\\{{0,8}}{re.escape(letter)}|(?i:\\{{1,8}}u{code:04x}|{url}))"


def _hex_digit(digit: str) -> str:
    return f"(?:{_letter(digit)}|{_letter(digit.upper())})"


PAUSE_MAX_S = 60.0  # a server that wants more than this is left alone
RETRIED = ("unreachable", "rate_limited", "server_error")
_REFUSED_KEY = (401, 403)


def _pause(stop: Interrupt, seconds: float) -> None:
    stop.wait(seconds)


@dataclass(slots=True)
class Endpoint:
    """One server and one model. Safe to be used by several threads.

    line, now, pause : replaced in tests, which never wait
    """

    settings: LlmSettings
    budget: Budget
    key: Secret | None = field(default=None, repr=False)
    line: Post = post
    now: Callable[[], float] = time.monotonic
    pause: Callable[[Interrupt, float], None] = _pause
    _dialect: Dialect = field(default_factory=Dialect)
    _proven: frozenset[str] = frozenset()  # parts of requests that the server has answered
    _calls_natively: bool = False  # it has called a tool that was offered natively

    def chat(
        self,
        messages: Sequence[Message],
        tools: Sequence[ToolSpec] = (),
        temperature: float = 0.0,
        schema: Schema | None = None,
        deadline_s: float = math.inf,
        stop: Interrupt | None = None,
        turn: Turn = Turn.EITHER,
    ) -> Reply:
        """One exchange.

        deadline_s : for all of it, retries and their pauses among it
        stop : ends it at once when fired
        turn : where the prompt carries the tools, the form admits this alone; natively spoken tools are not
            offered when the answer is due
        Errors : LlmFailure
        """
        settings, stop = self.settings, stop or Interrupt()
        chat = Chat(settings.model, messages, settings.answer_tokens, tools, temperature, schema, turn)
        end_s, tries = self.now() + deadline_s, 0
        while True:
            try:
                return self._exchange(chat, end_s, stop)
            except _TryAgain as again:
                tries += 1
                # A pause that cannot end before the deadline is not begun: the fallback acts at once instead.
                pause_s = max(settings.backoff_s * 2.0 ** (tries - 1), again.after_s)
                waits = pause_s <= PAUSE_MAX_S and self.now() + pause_s < end_s
                if tries > settings.retries or not waits:
                    raise again.failure from None
                self.pause(stop, pause_s)
            if stop.fired:
                raise LlmFailure("interrupted", "nobody waits for the answer any more")

    def _exchange(self, chat: Chat, end_s: float, stop: Interrupt) -> Reply:
        """Ask once, and once more where tools were offered and neither a call nor an object came back."""
        if chat.turn is Turn.ANSWER and self._dialect.native_tools:
            chat = replace(chat, tools=())
        if not (chat.tools and self._dialect.native_tools and chat.schema is not None):
            return self._ask(chat, self._dialect, end_s, stop)
        try:
            reply = self._ask(chat, self._dialect, end_s, stop)
        except LlmFailure as failure:
            if failure.kind not in ("malformed", "truncated"):
                raise
        else:
            self._calls_natively |= bool(reply.tool_calls) and self._dialect.native_tools
            if reply.tool_calls or _is_object(reply.content):
                return reply
        if self._calls_natively:  # its tools stand in the way of the form: now without
            return self._ask(replace(chat, tools=()), self._dialect, end_s, stop)
        return self._ask(chat, replace(self._dialect, native_tools=False), end_s, stop)

    def _ask(self, chat: Chat, dialect: Dialect, end_s: float, stop: Interrupt) -> Reply:
        """Ask in a dialect, or in a simpler one where the server refuses a part that it can do without."""
        body = _body(chat, dialect)
        response, used = self._send(body, end_s, stop)
        while response.status in REFUSALS and not chat.uses(dialect) <= self._proven:
            simpler = dialect.after_refusal(response.raw.decode(), bool(chat.tools))
            if simpler is None:
                break
            dialect = simpler
            if body != (body := _body(chat, dialect)):
                response, used = self._send(body, end_s, stop)
        self._check(response)
        reply = read_reply(read_document(response.raw), used)
        self._dialect = dialect
        self._proven |= chat.uses(dialect)
        return read_call(reply) if chat.tools and not dialect.native_tools else reply

    def _send(self, body: bytes, end_s: float, stop: Interrupt) -> tuple[HttpResponse, Usage]:
        """One request on the line, paid for whatever comes of it."""
        left_s = end_s - self.now()
        if not left_s > 0.0:  # NaN lands here too
            raise LlmFailure("timeout", "the time for this answer is over")
        most = Usage(estimated_tokens(body), self.settings.answer_tokens, estimated=True)
        self.budget.charge(most)
        used = Usage(estimated=True)
        try:
            deadline_s = min(self.settings.timeout_s, left_s)
            response = self._mask(self.line(self._url, body, self._headers(), deadline_s, stop))
            used = _usage(response, most)
            return response, used
        except LlmFailure as failure:
            if failure.kind in ("timeout", "interrupted", "malformed"):  # the server may well have worked
                used = Usage(most.sent, 0, estimated=True)
            if failure.kind in RETRIED:
                raise _TryAgain(failure) from None
            raise
        finally:
            self.budget.settle(most, used)

    def _check(self, response: HttpResponse) -> None:
        """Errors: LlmFailure, _TryAgain, for all but a 2xx."""
        status = response.status
        if 200 <= status < 300:
            return
        if status in _REFUSED_KEY:  # what it says may repeat the key
            raise LlmFailure("refused_key", f"status {status}: llm.key_file is missing or wrong")
        said = f"status {status}: {plain(response.raw.decode())}"
        if status == 429:
            raise _TryAgain(LlmFailure("rate_limited", said), retry_after_s(response.retry_after))
        if status >= 500:
            raise _TryAgain(LlmFailure("server_error", said), retry_after_s(response.retry_after))
        raise LlmFailure("bad_request", said)

    def _mask(self, response: HttpResponse) -> HttpResponse:
        """Return the response as UTF-8 with the key masked, since a server may echo it."""
        text = response.raw.decode(errors="replace")
        pattern = None if self.key is None else key_pattern(self.key.value)
        return replace(response, raw=(text if pattern is None else pattern.sub(MASK, text)).encode())

    @property
    def _url(self) -> str:
        return self.settings.url.rstrip("/") + "/chat/completions"

    def _headers(self) -> dict[str, str]:
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if self.key is not None:
            headers["Authorization"] = f"Bearer {self.key.value}"
        return headers


class _TryAgain(Exception):
    """A failure that another attempt may cure, after so many seconds."""

    def __init__(self, failure: LlmFailure, after_s: float = 0.0) -> None:
        super().__init__(str(failure))
        self.failure = failure
        self.after_s = after_s


def _body(chat: Chat, dialect: Dialect) -> bytes:
    spoken = chat if dialect.native_tools else without_native_tools(chat)
    return to_bytes(spoken.body(dialect))


def _is_object(content: str | None) -> bool:
    try:
        read_object(content)
    except LlmFailure:
        return False
    return True


def _usage(response: HttpResponse, most: Usage) -> Usage:
    """As counted by the server, else estimated; an error that says nothing of it has cost nothing."""
    try:
        counted = read_usage(read_document(response.raw))
    except LlmFailure:
        counted = None
    if counted is not None:
        return counted
    if not 200 <= response.status < 300:
        return Usage(estimated=True)
    return Usage(most.sent, estimated_tokens(response.raw), estimated=True)


def retry_after_s(text: str) -> float:
    """Seconds of a Retry-After header; 0 where there is none, inf where it is a date or nonsense.

    A date would need both clocks to agree; the fallback decides meanwhile, and the next question asks anew.
    """
    if not text:
        return 0.0
    try:
        seconds = float(text)
    except ValueError:
        return math.inf
    return seconds if seconds >= 0.0 else math.inf
