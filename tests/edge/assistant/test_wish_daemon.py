"""Wishes and why through the whole daemon as a process: command line, control socket and broker."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.daemon_process import RIG, DaemonProcess
from tests.support.virtual_board import VirtualBoard
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

WISH = "keep 26 by day and 20 at night, go easy on the fan"
RULES = {"model": "", "controller": "rules"}


@pytest.fixture
def model() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def daemon_of(folder: Path, model: StandIn | None, port: int | None = None, **control: Any) -> DaemonProcess:
    llm = {} if model is None else {"url": model.url, "model": "stand-in"}
    return DaemonProcess(
        folder, port, control={**RULES, **control}, llm=llm, bundle={"path": str(folder / "bundles")}
    )


def standing(daemon: DaemonProcess) -> dict[str, Any]:
    return dict(daemon.ask("status")["operation"])


def saved(daemon: DaemonProcess) -> dict[str, Any]:
    """Standing orders on disk, where they are a moment later."""
    there = daemon.state_file.exists()
    return dict(json.loads(daemon.state_file.read_text())["operation"]) if there else {}


def said_to(*words: str) -> int:
    return main(list(words))


def test_a_wish_is_shown_with_its_effect_and_applied_only_when_confirmed(
    folder: Path, board: VirtualBoard, model: StandIn, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon_of(folder, model, step_s=60) as daemon:
        socket = ("--socket", str(daemon.socket))
        assert said_to("ask", WISH, *socket) == 0
        page = capsys.readouterr().out
        assert "reference every day: 26 °C from 06:00, 20 °C from 22:00" in page
        assert "penalty of the fan: 5" in page
        assert "the next 24 h by the twin" in page
        assert standing(daemon)["steering"] is None  # nobody said yes

        id = page.splitlines()[0].removeprefix("proposal ")
        assert said_to("confirm", id, *socket) == 0
        assert standing(daemon)["steering"]["words"] == WISH
        assert said_to("confirm", id, *socket) == 1  # once is enough
        wait_for(lambda: (saved(daemon).get("steering") or {}).get("id") == id)

        assert said_to("undo", *socket) == 0
        assert standing(daemon)["steering"] is None
        assert said_to("undo", *socket) == 1
        assert "nothing that was asked for in words" in capsys.readouterr().out

        assert said_to("ask", "make it nice", *socket) == 1
        assert "Which temperature do you want" in capsys.readouterr().out


def test_a_confirmed_wish_moves_the_reference_outlives_a_kill_and_ends_by_itself(
    folder: Path, board: VirtualBoard, model: StandIn
) -> None:
    with daemon_of(folder, model, step_s=1) as daemon:
        socket = ("--socket", str(daemon.socket))
        assert said_to("ask", "--yes", "keep 27", *socket) == 0
        wait_for(lambda: daemon.ask("status")["tick"]["reference_c"] == 27.0)
        daemon.kill()
        daemon.start()
        wait_for(lambda: daemon.ask("status")["tick"]["reference_c"] == 27.0)
        short = {**standing(daemon)["steering"], "until_utc": daemon.ask("status")["tick"]["utc"] + 2.0}
        assert daemon.ask("steer", steering=short)["ok"]
        wait_for(lambda: standing(daemon)["steering"] is None)
        wait_for(lambda: daemon.has_event("steering.ended"))
        wait_for(lambda: daemon.ask("status")["tick"]["reference_c"] == 32.0)


def test_what_was_decided_is_remembered_over_a_kill_listed_edited_and_forgotten(
    folder: Path, board: VirtualBoard, model: StandIn, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon_of(folder, model, step_s=60) as daemon:
        socket = ("--socket", str(daemon.socket))

        def listed(*words: str) -> list[str]:
            capsys.readouterr()
            assert said_to("memory", *(words or ("list",)), *socket) == 0
            return capsys.readouterr().out.splitlines()

        assert listed() == ["nothing is remembered"]
        said_to("ask", WISH, *socket)
        id = capsys.readouterr().out.splitlines()[0].removeprefix("proposal ")
        assert said_to("discard", id, "--why", "the basil wilts", *socket) == 0
        assert said_to("ask", "--yes", "keep 27", *socket) == 0
        assert listed("add", "no", "fan", "at", "night") == ["done"]
        daemon.kill()
        daemon.start()
        note, confirmed, discarded = listed()
        assert note.endswith("note: no fan at night")
        assert 'confirmed: "keep 27"; settings: reference every day: 27 °C' in confirmed
        assert f'discarded: "{WISH}"; because: the basil wilts' in discarded
        assert said_to("undo", "--why", "too warm", *socket) == 0
        assert 'undone: "keep 27"; because: too warm' in listed()[0]

        before = len(model.requests)
        said_to("ask", "as yesterday, but no fan", *socket)
        asked = json.dumps(model.requests[before:], ensure_ascii=False)
        assert all(words in asked for words in ("no fan at night", "the basil wilts", "too warm"))

        number = note.split()[0]
        assert listed("edit", number, "the fan may run") == ["done"]
        assert listed()[1].endswith("note, edited: the fan may run")
        assert listed("forget", number) == ["done"]
        assert said_to("memory", "forget", number, *socket) == 1
        assert said_to("memory", "forget", *socket) == 1
        assert len(listed()) == 2
        assert listed("forget", "--all") == ["done"]
        assert listed() == ["nothing is remembered"]


@needs_mosquitto
def test_wish_confirmation_undo_and_why_over_the_broker(
    folder: Path, board: VirtualBoard, model: StandIn
) -> None:
    with (
        Broker(folder) as broker,
        Listener(broker.port, f"{RIG}/#") as listener,
        daemon_of(folder, model, broker.port, step_s=1) as daemon,
    ):

        def answered(what: str, payload: str) -> dict[str, Any]:
            before = len(listener.objects(f"{RIG}/reply"))
            listener.send(f"{RIG}/set/{what}", payload)
            wait_for(lambda: len(listener.objects(f"{RIG}/reply")) > before)
            return dict(listener.objects(f"{RIG}/reply")[-1])

        assert answered("ask", WISH)["proposal"]["state"] == "thinking"
        wait_for(lambda: listener.objects(f"{RIG}/proposal")[-1]["state"] not in ("none", "thinking"))
        proposal = listener.objects(f"{RIG}/proposal")[-1]
        assert proposal["state"] == "ready"
        assert standing(daemon)["steering"] is None
        assert not answered("confirm", "000000")["ok"]
        assert answered("confirm", proposal["id"])["ok"]
        assert standing(daemon)["steering"]["id"] == proposal["id"]
        wait_for(lambda: listener.objects(f"{RIG}/proposal")[-1]["state"] == "confirmed")
        assert answered("undo", "PRESS")["ok"]
        wait_for(lambda: listener.objects(f"{RIG}/proposal")[-1]["state"] == "undone")
        assert standing(daemon)["steering"] is None
        wait_for(lambda: daemon.ask("status")["tick"]["controller"] == "rules")
        daemon.wait_ticks(1)
        assert any("rules wanted heater" in line for line in answered("why", "")["lines"])
        answered("ask", WISH)
        wait_for(lambda: listener.objects(f"{RIG}/proposal")[-1]["state"] == "ready")
        other = listener.objects(f"{RIG}/proposal")[-1]
        assert answered("discard", f"{other['id']} the basil wilts")["ok"]
        discarded, undone = daemon.ask("memory")["facts"]
        assert (discarded["kind"], undone["kind"]) == ("discarded", "undone")
        assert "because: the basil wilts; settings: " in discarded["text"]


def test_why_is_answered_without_a_language_model(
    folder: Path, board: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon_of(folder, None, step_s=1) as daemon:
        socket = ("--socket", str(daemon.socket))
        wait_for(lambda: daemon.ask("status")["tick"]["controller"] == "rules")
        daemon.wait_ticks(1)
        assert said_to("why", *socket) == 0
        out = capsys.readouterr().out
        assert "rules wanted heater" in out
        assert "below the reference: heat" in out
        assert said_to("ask", WISH, *socket) == 2
        assert "llm.url is empty" in capsys.readouterr().err
        assert said_to("why", "--at", "2001-01-01T00:00", *socket) == 2
        assert "no tick is recorded before that time" in capsys.readouterr().err


def test_a_model_that_refuses_is_told_and_nothing_changes(
    folder: Path, board: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    with StandIn("refusal") as model, daemon_of(folder, model, step_s=60) as daemon:
        assert said_to("ask", WISH, "--socket", str(daemon.socket)) == 1
        assert "failed: refusal" in capsys.readouterr().out
        assert standing(daemon)["steering"] is None
