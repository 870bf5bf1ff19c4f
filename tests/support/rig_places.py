"""Fixtures of tests that run the whole daemon: name this file in `pytest_plugins`."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from edge.mqtt import connection, telemetry
from tests.support.virtual_board import VirtualBoard, virtual_board


@pytest.fixture
def folder() -> Iterator[Path]:
    """Short, for the names of sockets."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        yield Path(name)


@pytest.fixture
def board(folder: Path) -> Iterator[VirtualBoard]:
    """A board in real time."""
    with virtual_board(folder, "--real-time") as running:
        yield running


@pytest.fixture
def quick_reconnect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A daemon that tries a broker again after tenths of a second."""
    monkeypatch.setattr(connection, "RECONNECT_MIN_S", 0.1)
    monkeypatch.setattr(connection, "RECONNECT_MAX_S", 0.2)
    monkeypatch.setattr(telemetry, "POLL_S", 0.05)
