"""Hypothesis: no deadlines, since timings are not asserted; the same examples on every CI run.

The files that take longest begin first, so that no worker ends with one while the others wait.
"""

import os
import subprocess
import tempfile
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.builds import FOLDER_VARIABLE, built

# Tests run beside each other: a library that starts a thread for each core makes all of them wait.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read once, at the first import of numpy or torch
    os.environ.setdefault(_name, "1")

LONGEST_FIRST = (
    *("test_closed_loop", "test_nightly_for_real", "test_control_clairvoyant", "test_resolve_alias"),
    *("test_no_false_alarms", "test_whole_daemon", "test_llm_misbehaviours", "test_safety_mutation"),
)

AVR_HOST_SOURCE = Path(__file__).parent / "firmware_protocol" / "avr" / "avr_host.c"
LACKS = ("is not installed", "is missing", "apt install", "could not import")  # reasons to skip a test

settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("person", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "person")


def pytest_configure(config: pytest.Config) -> None:
    """One folder for what is compiled; the workers inherit its name from the process that starts them."""
    if FOLDER_VARIABLE not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="greenhouse-builds-")
        os.environ[FOLDER_VARIABLE] = folder.name
        config.add_cleanup(folder.cleanup)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stable: within a file, and among the others, the order stays."""
    place = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: place.get(Path(item.path).stem, len(place)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A person may lack a program. `make test` installs them all, so in CI nothing is skipped for one."""
    report = yield
    lacks = any(words in str(report.longrepr) for words in LACKS)
    if os.environ.get("CI") and report.skipped and lacks:
        report.outcome = "failed"
    return report


@pytest.fixture(scope="session")
def avr_host() -> Path:
    """The program that runs a board's program in simavr."""
    return built("avr_host", compile_avr_host, [AVR_HOST_SOURCE])


def compile_avr_host(target: Path) -> None:
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["gcc", *flags, str(AVR_HOST_SOURCE), "-lsimavr", "-lelf", "-o", str(target)], check=True)
