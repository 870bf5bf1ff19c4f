"""Change the C board in one place at a time and list the changes that no test of this directory notices.

    python tests/conformance/mutate.py [gh_safety.c ...]

About half an hour for all three files; not part of `make test`. A change first meets the test that notices
most (both boards in use), then the whole suite over the C board, then over the one with the sanitizers.
"""

import functools
import os
import random
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import test_board_differential as differential  # noqa: E402

from firmware_protocol.messages import Capability  # noqa: E402
from firmware_protocol.virtual_board import c_core  # noqa: E402
from firmware_protocol.virtual_board.board_config import BoardConfig  # noqa: E402
from firmware_protocol.virtual_board.core import BoardCore  # noqa: E402

FILES = ["gh_frame.c", "gh_safety.c", "gh_board.c"]
SOURCES = c_core.SOURCES
HANGS_AFTER_S = 120
WORKERS = 2

OPERATORS = {
    "<": ["<=", ">="], ">": [">=", "<="], "<=": ["<", ">"], ">=": [">", "<"], "==": ["!="], "!=": ["=="],
    "&&": ["||"], "||": ["&&"], "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "%": ["*"], "&": ["|"],
    "^": ["|"], "<<": [">>"], ">>": ["<<"], "+=": ["-="], "-=": ["+="], "++": ["--"],
    "true": ["false"], "false": ["true"], "break": [""], "!": [""],
}  # fmt: skip
TOKEN = re.compile(
    r"(?P<skip>/\*.*?\*/|\"[^\"\n]*\"|^#include.*?$|->)"
    r"|(?P<number>\b(?:0x[0-9A-Fa-f]+|\d+)(?=u?\b))"
    r"|(?P<operator>\b(?:true|false|break)\b|<<|>>|<=|>=|==|!=|&&|\|\||\+\+|\+=|-="
    r"|(?<= )[-+*/%&^<>](?= )|!(?=\w))",
    re.DOTALL | re.MULTILINE,
)
NOT_LEFT_OUT = "return|break|case|default|const |u?int|size_t|bool|gh_|static|for |while "
STATEMENT = re.compile(rf"^ +(?!{NOT_LEFT_OUT})[^\n{{}}]*;", re.MULTILINE)
CALL = re.compile(r"^ +gh_\w+\([^\n]*\);", re.MULTILINE)

EQUIVALENT: dict[str, str] = {}


def changes(text: str) -> Iterator[tuple[int, int, str]]:
    """(begin, end, what stands there instead)"""
    for found in TOKEN.finditer(text):
        if found["number"]:
            yield found.start(), found.end(), str(int(found["number"], 0) + 1)
        for other in OPERATORS.get(found["operator"] or "", []):
            yield found.start(), found.end(), other
    for pattern in (STATEMENT, CALL):
        for found in pattern.finditer(text):
            yield found.start(), found.end(), ";"


def name_of(file: str, text: str, begin: int, end: int, by: str) -> str:
    """Where and what, without a line number, so that it lasts."""
    line = text[text.rfind("\n", 0, begin) + 1 : text.find("\n", end)].strip()
    return f"{file}: {text[begin:end].strip()!r} -> {by!r}  in  {line}"


def notices(directory: Path) -> bool:
    """Whether a test fails with the sources of that directory; in a process that is thrown away."""
    child = os.fork()
    if child == 0:
        os.setpgrp()
        signal.alarm(HANGS_AFTER_S)
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1), os.dup2(quiet, 2)
        try:
            c_core.SOURCES = directory
            play()
            suite = ["-x", "-q", "-p", "no:cacheprovider", str(HERE), "-k"]
            code = pytest.main([*suite, "not python and not sanitized"]) or pytest.main([*suite, "sanitized"])
        except BaseException:
            code = 1
        os._exit(int(code))
    return os.waitpid(child, 0)[1] != 0


def play() -> None:
    """The hour of seed 0. Raises when the two boards differ or the C board does not compile."""
    config = BoardConfig(capabilities=Capability(0x3FF))
    boards = [make(config, b"", 0, 1) for make in (BoardCore, c_core.CBoardCore)]
    for now_ms, action, what in differential.hour(random.Random(0)):
        differential.act_on(boards, action, what, now_ms % 2**32)


def survivor(file: str, text: str, change: tuple[int, int, str]) -> str | None:
    """The name of a change that no test notices."""
    begin, end, by = change
    with tempfile.TemporaryDirectory(prefix="mutant-") as directory:
        for source in SOURCES.glob("gh_*"):
            shutil.copy(source, directory)
        (Path(directory) / file).write_text(text[:begin] + by + text[end:], encoding="utf-8")
        return None if notices(Path(directory)) else name_of(file, text, begin, end, by)


def main(files: list[str]) -> int:
    if notices(SOURCES):
        print("the tests fail without a change")
        return 2
    unknown = 0
    for file in files:
        text = (SOURCES / file).read_text(encoding="utf-8")
        found = list(changes(text))
        with ThreadPoolExecutor(WORKERS) as pool:
            for tried, name in enumerate(pool.map(functools.partial(survivor, file, text), found), 1):
                print(f"{file}: {tried} of {len(found)}", end="\r", file=sys.stderr)
                if name is not None and name not in EQUIVALENT:
                    unknown += 1
                    print(name, flush=True)
        print(f"{file}: {len(found)} changes", flush=True)
    print(f"{unknown} changes survive")
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or FILES))
