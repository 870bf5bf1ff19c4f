"""Shared parts of the tests of records."""

from pathlib import Path

import pytest
from sealed_records import RecordRig


@pytest.fixture
def rig(tmp_path: Path) -> RecordRig:
    """A rig without ticks yet."""
    return RecordRig(tmp_path / "rig")
