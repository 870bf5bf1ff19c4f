"""Lines of a test on a booted machine: printed at once, and kept for its file of results."""

import sys
import time
from collections.abc import Callable


class BootReport:
    """Prints lines and keeps them; the first check that fails ends the test."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        """Print a line."""
        print(line, flush=True)
        self.lines.append(line)

    def check(self, text: str, passed: object, found: object = "") -> None:
        """Print a check. Errors: SystemExit where it fails"""
        self.say(f"{'ok  ' if passed else 'FAIL'} {text}{f': {found}' if found != '' else ''}")
        if not passed:
            sys.exit(1)


def wait_for(condition: Callable[[], object], patience_s: float, text: str) -> float:
    """Wait, and return how long it took [s]. Errors: TimeoutError"""
    began = time.monotonic()
    while not condition():
        if time.monotonic() > began + patience_s:
            raise TimeoutError(f"not in {patience_s:g} s: {text}")
        time.sleep(0.5)
    return time.monotonic() - began
