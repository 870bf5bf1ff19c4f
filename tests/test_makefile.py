"""The commands that a newcomer types, and what CI runs: the Makefile's own, without running them."""

import re
import shutil
import subprocess

import pytest

from fleet.machine.engines import PACKAGES
from tests.support.daemon_process import ROOT

MAKEFILE = (ROOT / "Makefile").read_text()

needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def plan(target: str) -> str:
    """Return what `make TARGET` would do in a tree that has nothing installed."""
    command = ["make", "--dry-run", "--always-make", "PYTHON=python3", target]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def phony() -> set[str]:
    """Targets that are commands."""
    return set(re.findall(r"^\.PHONY: (.*)$", MAKEFILE, re.MULTILINE)[0].split())


def test_the_readmes_two_commands_are_targets() -> None:
    section = (ROOT / "README.md").read_text().split("## Two commands", 1)[1].split("\n## ", 1)[0]
    assert re.findall(r"^make (\w+)", section, re.MULTILINE) == ["run", "test"]
    assert {"run", "test"} <= phony()


def test_every_command_has_a_rule() -> None:
    assert {name for name in phony() if not re.search(rf"^{name}:", MAKEFILE, re.MULTILINE)} == set()


@needs_make
def test_run_installs_the_edge_packages_only() -> None:
    commands = plan("run")
    assert re.search(r"pip install .*--editable '\.\[page\]'$", commands, re.MULTILINE)
    assert "greenhouse demo" in commands
    assert "install_tools" not in commands
    assert "[dev]" not in commands


@needs_make
def test_test_installs_what_the_tests_need_first() -> None:
    commands = plan("test")
    assert 0 < commands.index(".[dev]") < commands.index("pytest")
    assert 0 < commands.index("install_tools.sh") < commands.index("pytest")


def test_the_engines_of_a_fleet_are_among_what_it_installs() -> None:
    assert {*PACKAGES.values()} <= {*re.findall(r"[\w-]+", (ROOT / "tests" / "install_tools.sh").read_text())}


@needs_make
@pytest.mark.parametrize(
    ("target", "programs"), [("lint", ["ruff check", "ruff format", "mypy"]), ("bench", ["-m bench"])]
)
def test_the_other_commands_run_what_they_say(target: str, programs: list[str]) -> None:
    commands = plan(target)
    assert all(program in commands for program in programs)


def test_ci_runs_lint_and_the_readmes_test_command() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & 0o111
    assert [line for line in script.read_text().splitlines() if line.startswith("make")] == [
        "make lint",
        "make test",
        "make docs",
    ]
