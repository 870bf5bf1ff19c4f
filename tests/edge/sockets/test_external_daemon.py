"""`external` in the daemon: a client drives the virtual rig, and the fallback does when it is gone."""

import json
import socket
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import ExternalSettings
from training.lab import Lab

pytestmark = pytest.mark.slow

ANSWERED = 3


def client(path: Path) -> threading.Thread:
    """Proposes 0.2 for ANSWERED ticks, then goes away."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(str(path))

    def run() -> None:
        with connection, connection.makefile("rb") as lines:
            for _ in range(ANSWERED):
                tick = json.loads(lines.readline())["tick"]
                answer = {"tick": tick, "heater_duty": 0.2, "fan_on": False}
                connection.sendall(json.dumps(answer).encode() + b"\n")

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def test_a_client_drives_the_rig_and_the_fallback_when_it_has_gone(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, config.default())
    where = tmp_path / "external.sock"
    settings = replace(
        settings,
        control=replace(settings.control, controller="external"),
        external=ExternalSettings(str(where)),
    )
    clients: list[threading.Thread] = []
    with Lab(settings, folder=tmp_path, on_start=lambda: clients.append(client(where))) as lab:
        lab.run(ticks=ANSWERED + 2)
    clients[0].join()
    ticks = lab.history
    assert [tick.decision.controller for tick in ticks] == ["external"] * ANSWERED + ["MPC"] * 2
    assert all(tick.sent.heater_duty == 0.2 for tick in ticks[:ANSWERED])
    assert [tick.decision.why.get("failure", "") for tick in ticks[ANSWERED:]] == ["controller.raised"] * 2
    told = [event.text for tick in ticks for event in tick.events if event.key == "controller.error"]
    assert len(told) == 2
    assert "external: RequestError: " in told[0]
    assert not where.exists()
