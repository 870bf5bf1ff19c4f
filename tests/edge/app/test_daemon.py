"""edge/app/request_routes.py: what is done in the asker's thread."""

from dataclasses import replace
from pathlib import Path

import pytest
from history_records import store, tick

from edge.app.request_routes import resend
from edge.config import loading as config
from edge.config.settings import HistorySettings, Settings
from edge.mqtt.commands import Resend


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """With a history of three ticks, all waiting to be sent."""
    store(tmp_path / "history.db", *(tick(seq) for seq in (1, 2, 3)))
    return replace(config.default(), history=HistorySettings(path=str(tmp_path / "history.db")))


@pytest.mark.parametrize(("first", "last", "queued"), [(1, 1, 1), (2, 3, 2), (1, 2**63 - 1, 3), (9, 9, 0)])
def test_a_span_of_numbers_is_queued_again(settings: Settings, first: int, last: int, queued: int) -> None:
    answer = {"ok": True, "queued": queued, "first_seq": first, "last_seq": last}
    assert resend(settings, Resend(first, last)) == answer


def test_a_resend_without_a_history_is_refused_and_makes_none(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    settings = replace(config.default(), history=HistorySettings(path=str(path)))
    assert not resend(settings, Resend(1, 2))["ok"]
    assert not path.exists()
