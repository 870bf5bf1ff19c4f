"""Hypothesis: no deadlines, since timings are not asserted; the same examples on every CI run.

The files that take longest begin first, so that no worker ends with one while the others wait.
No test reaches for an installation on this machine, nor do the Python processes that it starts.
"""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import machine_places  # first: from here on the places are hidden
import pytest
from hypothesis import settings

from tests.support.builds import FOLDER_VARIABLE, built

# Tests run in parallel: a library that starts a thread for each core slows all of them.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read once, at the first import of numpy or torch
    os.environ.setdefault(_name, "1")

LONGEST_FIRST = (
    *("test_whole_daemon", "test_browser", "test_llm_daemon", "test_bounds", "test_experiment"),
    *("test_commission_pause", "test_no_false_alarms", "test_output_check", "test_runner", "test_demo"),
    *("test_scenarios", "test_closed_loop", "test_flash", "test_models", "test_twin_diagnose", "test_deploy"),
)

AVR_HOST_SOURCE = Path(__file__).parent / "firmware_protocol" / "avr" / "avr_host.c"
LACKS = ("is not installed", "is missing", "apt install", "could not import")  # reasons to skip a test

settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("person", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "person")

AT_START, SEARCHED = str(Path(machine_places.__file__).parent), "PYTHONPATH"
if AT_START not in os.environ.get(SEARCHED, "").split(os.pathsep):  # a worker of xdist inherits it
    os.environ[SEARCHED] = os.pathsep.join(filter(None, (AT_START, os.environ.get(SEARCHED))))

for number in (signal.SIGINT, signal.SIGHUP):  # ignored in the background, which processes would inherit
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, lambda *_: None)


def pytest_configure(config: pytest.Config) -> None:
    """One folder for what is compiled; the workers inherit its name from the process that starts them."""
    if FOLDER_VARIABLE not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="greenhouse-builds-")
        os.environ[FOLDER_VARIABLE] = folder.name
        config.add_cleanup(folder.cleanup)


@pytest.fixture(scope="session")
def offences(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """File of what this worker's tests and their processes did to the machine's own places.

    Demos that tests start are not among this person's: their folder is below TMPDIR.
    """
    file = tmp_path_factory.mktemp("offences") / "offences"
    os.environ[machine_places.OFFENCES] = str(file)
    with tempfile.TemporaryDirectory(prefix="gh-") as short, pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", short)
        yield file


@pytest.fixture(autouse=True)
def leave_the_machine_alone(offences: Path) -> Iterator[None]:
    """Fail a test that reached for one of `machine_places.PLACES`."""
    yield
    if offences.exists():
        found = offences.read_text()
        offences.unlink()
        pytest.fail(f"a test must be given paths of its own:\n{found}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stable: within a file, and among the others, the order stays."""
    place = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: place.get(Path(item.path).stem, len(place)))


def pytest_sessionfinish() -> None:
    """End the browsers that tests share, if any did."""
    if shared := sys.modules.get("tests.support.browser"):
        shared.quit_shared_browsers()


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
