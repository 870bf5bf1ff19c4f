"""The simulator of the board's programs, compiled once."""

import subprocess
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def host(tmp_path_factory):
    """The simulator's program."""
    target = tmp_path_factory.mktemp("host") / "avr_host"
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
    source = Path(__file__).parent / "avr" / "avr_host.c"
    subprocess.run(["gcc", *flags, str(source), "-lsimavr", "-lelf", "-o", str(target)], check=True)
    return target
