"""Evil text through the whole daemon as a process: every tick is stored, and an echoed key is masked."""

import base64
import itertools
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, quote_plus

import pytest

from edge.assistant.llm.endpoint import MASK, key_pattern
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import VirtualBoard, virtual_board
from training.llm_stand_in.behaviours import Sending, refusal
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

EVIL = "\ud800\x1b[2J\x00\u202e"


def ask(daemon: DaemonProcess, line: bytes) -> dict[str, Any]:
    """One raw line over the control socket."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(15.0)
        connection.connect(str(daemon.socket))
        connection.sendall(line + b"\n")
        return json.loads(connection.makefile("rb").readline())


def goes_on(daemon: DaemonProcess) -> None:
    """Two more ticks come, none was lost, and what is stored and printed is clean."""
    last = daemon.wait_ticks(2)
    wait_for(lambda: daemon.seqs()[-1] >= last)
    assert daemon.seqs() == list(range(1, daemon.seqs()[-1] + 1))
    assert not daemon.has_event("history.ticks_lost")
    stored = daemon.rows("SELECT text FROM events UNION ALL SELECT why FROM decisions")
    assert all(text.isprintable() for (text,) in stored)
    assert "\x1b" not in daemon.log


@pytest.mark.parametrize(
    ("behave", "said"),
    [
        ("surrogate_refusal", "refusal: the model refuses: I can't \ufffd help."),
        ("surrogate_rationale", ""),
        ("surrogate_key", "wrong_schema: unknown key '\ufffd'"),
        ("surrogate_claim", "'I have turned the fan on \ufffd.' (it can only propose"),
    ],
)
def test_a_language_model_that_answers_with_a_lone_surrogate_ends_nothing(
    folder: Path, board: VirtualBoard, behave: str, said: str
) -> None:
    with (
        StandIn(behave) as model,
        DaemonProcess(
            folder,
            control={"model": "", "controller": "LLM-Te0"},
            llm={"url": model.url, "model": "stand-in", "backoff_s": 0.0},
        ) as daemon,
    ):
        goes_on(daemon)
        texts = [text for (text,) in daemon.rows("SELECT text FROM events")]
        assert any(said in text for text in texts), texts
        if behave == "surrogate_rationale":
            whys = [json.loads(why) for (why,) in daemon.rows("SELECT why FROM decisions")]
            assert "Because [2J \ufffd I say so." in {why.get("rationale") for why in whys}


def test_orders_with_evil_keys_and_values_are_refused(folder: Path, board: VirtualBoard) -> None:
    evil = json.dumps(EVIL).encode()
    with DaemonProcess(folder) as daemon:
        refused = ask(daemon, b'{"do": "release_emergency_stop", %s: 1}' % evil)
        assert refused["error"].startswith("release_emergency_stop: unknown key '\ufffd ")
        assert refused["error"].endswith("; it takes none")
        refused = ask(daemon, b'{"do": "set_mode", "mode": "heat", "now": true}')
        assert refused["error"] == "set_mode: unknown key 'now'; known keys: mode"
        for line in (
            b'{"do": %s}' % evil,
            b'{"do": "set_mode", "mode": %s}' % evil,
            b'{"do": "set_controller", "name": %s}' % evil,
            b'{"do": "set_manual", "heater_duty": %s}' % evil,
            b'{"do": "maintenance", "minutes": %s}' % (b"9" * 4000),
            b'{"do": "steer", "steering": {"id": %s}}' % evil,
            b'{"do": "why", "at_utc": 1e300}',
            b'{"do": "bundle", "action": %s}' % evil,
            b'{"do": "confirm", "id": %s}' % evil,
            b'{"do": "resend", "first_seq": %s}' % evil,
            b'{"do": "status", %s: 1}' % evil,
            b'{"do": "clear_trip", %s: 1}' % evil,
            b'{"do": "why", %s: 1}' % evil,
        ):
            answer = ask(daemon, line)
            assert answer["ok"] is False
            assert not answer["error"].startswith("internal"), answer
            assert len(answer["error"]) < 400
        assert daemon.ask("status")["operation"]["mode"] == "auto"
        goes_on(daemon)


@needs_mosquitto
def test_evil_payloads_over_mqtt_are_refused(folder: Path, board: VirtualBoard) -> None:
    with (
        Broker(folder) as broker,
        Listener(broker.port, f"{RIG}/#") as listener,
        DaemonProcess(folder, broker.port) as daemon,
    ):
        wait_for(lambda: listener.objects(f"{RIG}/state"))
        for what, payload in (
            ("manual", json.dumps({"heater_duty": EVIL})),
            ("manual", json.dumps({EVIL: 1})),
            ("mode", b"\xed\xa0\x80"),
            ("mode", "\x1b[2J"),
            ("\u202eevil", "x" * 900),
            ("controller", "\u0007" * 500),
        ):
            listener.send(f"{RIG}/set/{what}", payload)
        wait_for(lambda: len(listener.objects(f"{RIG}/reply")) >= 6)
        assert not any(reply["ok"] for reply in listener.objects(f"{RIG}/reply"))
        goes_on(daemon)
        texts = [event["text"] for event in listener.objects(f"{RIG}/event")]
        assert all(text.isprintable() for text in texts)
        assert any(text.startswith("set/ evil: unknown command") for text in texts)


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
