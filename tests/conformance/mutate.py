"""Change the C board in one place at a time and list the changes that no test of this directory notices.

    python tests/conformance/mutate.py [gh_safety.c ...]        about 25 minutes

Not part of `make test`: a change that nobody notices costs a run of the suite over the C board with
the sanitizers, and there are some six hundred changes.
"""

import functools
import os
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

from tests.support import c_core  # noqa: E402

FILES = ["gh_frame.c", "gh_safety.c", "gh_board.c"]
SOURCES = c_core.SOURCES
HANGS_AFTER_S = 60
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

# Changes that change nothing: a line for each, and an indented one that says why.
EQUIVALENT = {
    line
    for line in (HERE / "equivalent_changes.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith(" ")
}


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
    """Return the place and the change, without a line number, so that it lasts."""
    line = text[text.rfind("\n", 0, begin) + 1 : text.find("\n", end)].strip()
    functions = re.findall(r"^\w[^;=\n]*?(\w+)\(", text[:begin], re.MULTILINE)
    return f"{file}: {functions[-1] if functions else '-'}: {text[begin:end].strip()!r} -> {by!r} in {line}"


class Mutation:
    """A pytest plugin: collects once, then tests each change in a process that is thrown away."""

    def __init__(self, files: list[str]) -> None:
        self._files = files
        self._order: list[pytest.Item] = []
        self._session: pytest.Session
        self.survivors = 0

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._session = session
        self._order = [item for item in session.items if "[python" not in item.name]
        if self._noticed(SOURCES):
            raise pytest.UsageError("the tests fail without a change")
        for file in self._files:
            text = (SOURCES / file).read_text(encoding="utf-8")
            found = list(changes(text))
            with ThreadPoolExecutor(WORKERS) as pool:
                for name in pool.map(functools.partial(self._survivor, file, text), found):
                    self._tell(name)
            print(f"{file}: {len(found)} changes", file=sys.stderr, flush=True)
        return True

    def _tell(self, name: str | None) -> None:
        if name is not None and name not in EQUIVALENT:
            self.survivors += 1
            print(name, file=sys.stderr, flush=True)

    def _survivor(self, file: str, text: str, change: tuple[int, int, str]) -> str | None:
        begin, end, by = change
        with tempfile.TemporaryDirectory(prefix="mutant-") as directory:
            for source in SOURCES.glob("gh_*"):
                shutil.copy(source, directory)
            (Path(directory) / file).write_text(text[:begin] + by + text[end:], encoding="utf-8")
            noticed = self._noticed(Path(directory))
        return None if noticed else name_of(file, text, begin, end, by)

    def _noticed(self, directory: Path) -> bool:
        """Return whether a test fails with the sources of that directory; it comes first from then on."""
        order = list(self._order)
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            signal.alarm(HANGS_AFTER_S)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1), os.dup2(quiet, 2)
            failed = self._first_failure(directory, order)
            os.write(writer, b"" if failed is None else str(failed).encode())
            os._exit(0 if failed is None else 1)
        os.close(writer)
        with os.fdopen(reader) as pipe:
            failed_at = pipe.read()
        if failed_at:
            item = order[int(failed_at)]
            self._order = [item, *(other for other in self._order if other is not item)]
        return os.waitpid(child, 0)[1] != 0

    def _first_failure(self, directory: Path, order: list[pytest.Item]) -> int | None:
        c_core.SOURCES = directory
        session = self._session
        for index, item in enumerate(order):
            following = order[index + 1] if index + 1 < len(order) else None
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                return index
        return None


def main(files: list[str]) -> int:
    mutation = Mutation(files)
    without = ["cacheprovider", "faulthandler", "timeout"]  # a timeout would take our alarm away
    options = ["-q", "-s", *(f"-pno:{name}" for name in without), str(HERE)]
    code = pytest.main(options, plugins=[mutation])
    print(f"{mutation.survivors} changes survive")
    return int(code) or (1 if mutation.survivors else 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or FILES))
