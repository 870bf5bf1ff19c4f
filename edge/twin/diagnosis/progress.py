"""What a long computation is doing, told while it does it."""

import shutil
import sys
from collections.abc import Callable
from types import TracebackType
from typing import Self, TextIO

Progress = Callable[[str], None]  # a short text, what is done now; called often


class TerminalProgress:
    """Progress on a terminal as one line that is rewritten, anywhere else as lines.

    A context manager: at its end the line is gone.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        """out : standard error unless given"""
        self._out = sys.stderr if out is None else out
        self._rewrites = self._out.isatty()

    def __call__(self, text: str) -> None:
        line = "".join(character if character.isprintable() else " " for character in text)
        if self._rewrites:
            columns = shutil.get_terminal_size().columns
            self._out.write(f"\r\x1b[K{line[: columns - 1]}")
        else:
            self._out.write(f"{line}\n")
        self._out.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._rewrites:
            self._out.write("\r\x1b[K")
            self._out.flush()
