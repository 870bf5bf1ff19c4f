"""One evil character through the whole daemon as a process: it goes on, and every tick is stored."""

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import VirtualBoard
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
        refused = ask(daemon, b'{"do": "emergency_stop", %s: 1}' % evil)
        assert refused["error"].startswith("emergency_stop: unknown key '\ufffd ")
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
