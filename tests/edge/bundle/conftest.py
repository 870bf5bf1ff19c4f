"""Shared parts of the tests of bundles."""

from pathlib import Path

import pytest
from bundles import Workshop


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path)
