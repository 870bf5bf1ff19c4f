"""edge/app/daemon.py: what is done in the asker's thread, and standing orders from disk."""

from dataclasses import replace
from pathlib import Path

import pytest
from history_records import tick

from edge.app.request_routes import resend
from edge.config import loading as config
from edge.config.settings import HistorySettings, Settings
from edge.core.clock import RealClock
from edge.core.errors import RequestError
from edge.mqtt.commands import Resend
from edge.state.store import STANDING, restore
from edge.storage import Storage
from edge.tick.orders import read_request


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """With a history of three ticks, all waiting to be sent."""
    history = HistorySettings(path=str(tmp_path / "history.db"))
    storage = Storage(history, RealClock())
    storage.open()
    for seq in (1, 2, 3):
        storage.write(tick(seq))
    assert storage.close(20.0)
    return replace(config.default(), history=history)


@pytest.mark.parametrize(("first", "last", "queued"), [(1, 1, 1), (2, 3, 2), (1, 2**63 - 1, 3), (9, 9, 0)])
def test_a_span_of_numbers_is_queued_again(settings: Settings, first: int, last: int, queued: int) -> None:
    assert resend(settings, Resend(first, last)) == {"ok": True, "queued": queued}


@pytest.mark.parametrize(
    ("first", "last"),
    [
        (0, 1),
        (-1, 1),
        (2, 1),
        (1, 2**63),
        (2**63, 2**63),
        (True, 2),
        (1, True),
        (1.0, 2),
        ("1", 2),
        (None, 2),
    ],
)
def test_what_is_no_span_of_numbers_is_refused(first: object, last: object) -> None:
    with pytest.raises(RequestError, match=r"^resend: (first|last)_seq: "):
        read_request(Resend, {"do": "resend", "first_seq": first, "last_seq": last})


def test_a_resend_without_a_history_is_refused_and_makes_none(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    settings = replace(config.default(), history=HistorySettings(path=str(path)))
    assert not resend(settings, Resend(1, 2))["ok"]
    assert not path.exists()


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"operation": {}, "safety": {}}'])
def test_a_state_file_that_is_not_understood_is_an_emergency_stop(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    standing = restore(STANDING, replace(config.default(), state_file=str(path)))
    assert standing.operation.emergency_stop
    assert standing.broken


def test_without_a_state_file_the_configured_controller_runs(tmp_path: Path) -> None:
    standing = restore(STANDING, replace(config.default(), state_file=str(tmp_path / "state.json")))
    assert standing.operation.controller == config.default().control.controller
    assert not standing.operation.emergency_stop
    assert standing.broken == ""
