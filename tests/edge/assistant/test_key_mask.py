"""edge/assistant/llm/endpoint.py: a key that a server echoes is found however it is written."""

import base64
import itertools
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import quote, quote_plus

import pytest

from edge.assistant.llm.endpoint import MASK, key_pattern
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import virtual_board
from training.llm_stand_in.behaviours import Sending, refusal
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow

KEY = "sk-ve/y+secret_0123456789~"
PATTERN = key_pattern(KEY)
assert PATTERN is not None
Write = Callable[[str], str]


def escaped(text: str) -> str:
    return "".join(f"\\u{ord(letter):04X}" for letter in text)


ENCODE: dict[str, Write] = {
    "plain": lambda text: text,
    "base64": lambda text: base64.b64encode(text.encode()).decode(),
    "base64 url-safe": lambda text: base64.urlsafe_b64encode(text.encode()).decode().rstrip("="),
    "hex": lambda text: text.encode().hex(),
    "HEX": lambda text: text.encode().hex(":").upper(),
}
QUOTE: dict[str, Write] = {
    "as it is": lambda text: text,
    "slashes": lambda text: text.replace("/", "\\/"),
    "JSON": escaped,
    "JSON in JSON": lambda text: json.dumps(json.dumps(escaped(text))),
    "URL": quote,
    "URL of a URL": lambda text: quote(quote_plus(text)),
    "all of a URL": lambda text: "".join(f"%{ord(letter):02x}" for letter in text),
}
AROUND = (("", ""), ("Bearer ", ""), ("Authorization: Bearer ", "!"), ("a", "b"), ('{"k": "', '"}'))


def forms(key: str) -> Iterator[str]:
    """Every way of writing it, within every text, in every encoding."""
    for (begin, end), encode, written in itertools.product(AROUND, ENCODE.values(), QUOTE.values()):
        yield written(encode(f"{begin}{key}{end}"))


def test_every_way_of_writing_the_key_is_masked() -> None:
    for form in forms(KEY):
        assert MASK in PATTERN.sub(MASK, f"I was given {form}, thank you"), form


def test_a_text_without_the_key_stays_as_it_is() -> None:
    for form in forms("sk-another/key+9876543210"):
        assert PATTERN.sub(MASK, form) == form


def test_a_masked_document_is_still_json() -> None:
    for form in forms(KEY):
        assert KEY not in str(json.loads(PATTERN.sub(MASK, json.dumps({"content": form}))))


def test_a_placeholder_is_not_a_secret() -> None:
    assert key_pattern("none") is None


@pytest.mark.parametrize("part", ["\\", "%25", "sk-ve", "\\u0073", "7", "c2st"])
def test_a_reply_of_the_largest_size_is_masked_in_time(part: str) -> None:
    begin_s = time.process_time()
    PATTERN.sub(MASK, part * ((1 << 20) // len(part)))
    assert time.process_time() - begin_s < 5.0


class EchoingServer(StandIn):
    """A server that gives the key back in every form, as a refusal, an error, a tool's name and arguments."""

    def sending(self, body: dict[str, object]) -> Sending:
        """One more form in one more place."""
        number = len(self.headers)
        words = f"You said {list(forms(KEY))[number % len(list(forms(KEY)))]}"
        turns = (
            {"role": "assistant", "content": None, "refusal": words},
            {
                "role": "assistant",
                "content": json.dumps({"heater_duty": 0.5, "fan_on": False, "rationale": words}),
            },
            {"role": "assistant", "content": json.dumps({words: 1})},
        )
        if number % 4 == 3:
            return refusal(400, words)
        document = {"choices": [{"index": 0, "message": turns[number % 4], "finish_reason": "stop"}]}
        return Sending(json.dumps(document).encode("utf-16" if number % 20 == 19 else "utf-8"))


@needs_mosquitto
def test_a_server_that_echoes_the_key_gets_it_nowhere(tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_text(KEY)
    key_file.chmod(0o600)
    with (
        Broker(tmp_path) as broker,
        Listener(broker.port, f"{RIG}/#") as listener,
        EchoingServer() as model,
        virtual_board(tmp_path, "--real-time"),
        DaemonProcess(
            tmp_path,
            broker.port,
            control={"model": "", "controller": "LLM-Te0", "step_s": 1},
            llm={"url": model.url, "model": "stand-in", "backoff_s": 0.0, "key_file": str(key_file)},
        ) as daemon,
    ):
        daemon.wait_ticks(8)
        wait_for(lambda: daemon.has_event("controller.error"))
        seq = daemon.seq()
        wait_for(lambda: any(tick["seq"] >= seq for tick in listener.objects(f"{RIG}/history/tick")))
        daemon.stop()
        heard = b"".join(message.payload for message in listener.heard)
        stored = b"".join(path.read_bytes() for path in tmp_path.glob("history.db*"))
        assert any(f"Bearer {KEY}" == headers["Authorization"] for headers in model.headers)
    found = f"{heard!r}{stored!r}{daemon.log}"
    assert [form for form in forms(KEY) if form in found] == []
    assert PATTERN.search(found) is None
    assert MASK in found
