"""One PostgreSQL and one browser for all tests of the fleet that may share one."""

from collections.abc import Iterator

import pytest
from selenium.webdriver.remote.webdriver import WebDriver

from tests.support.browser import browser
from tests.support.postgres import Postgres


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """Its tables are dropped by who has made them, or are in a database of their own."""
    with Postgres() as running:
        yield running


@pytest.fixture(scope="session")
def chromium() -> Iterator[WebDriver]:
    """Each test begins with `fleet_browser.as_new`."""
    with browser() as driver:
        yield driver
