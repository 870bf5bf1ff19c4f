"""Every test that asks for `new_board` runs over the Python board and the sanitized C board.

The C board as the virtual board loads it is held against the Python board in test_board_differential.py.
"""

import functools

import pytest
from board_kinds import DRIVER_SOURCE, Driver, SanitizedBoard, compile_driver, python_board

from tests.support import c_core
from tests.support.builds import built


@pytest.fixture(scope="session")
def driver_program():
    return built("board_driver", compile_driver, [DRIVER_SOURCE, *c_core.SOURCES.glob("gh_*")])


@pytest.fixture(scope="module", params=["python", "c"])
def new_board(request):
    """Makes a board: (config, persistent, reset_cause, boot_count) -> board. One at a time is in use."""
    if request.param == "python":
        yield python_board
    else:
        driver = Driver(request.getfixturevalue("driver_program"))
        yield functools.partial(SanitizedBoard, driver)
        assert driver.close() == ""
