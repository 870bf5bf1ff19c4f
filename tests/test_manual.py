"""Code of the manual and the README: what a reader types runs, or at least its command and options exist.

A fence without a title runs, in the order of its page, in an empty folder. So does Python whose title is the
name of a file, from that file. Text titled "it prints" is what the code before it prints. Other titles tell
where or when the code is typed. Such code is only parsed: commands and options by the program's own parsers,
modules and files by name. A command "at commit 02ed168c" exists there and is not looked for here.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

import edge.__main__ as greenhouse
import training.__main__ as greenhouse_train
from edge.config import loading
from edge.twin.twin_file import read_twin_file
from fleet.settings import load as load_fleet
from tests.support.daemon_process import ROOT
from tools import reference

DOCS = ROOT / "docs"
PAGES_BY_HAND = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
FENCE = re.compile(r'^```(\w+)(?: title="([^"]*)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
# "at commit 02ed168c" behind a command says that it is no longer here.
IN_A_LINE = re.compile(
    r"`((?:greenhouse|greenhouse-train|python -m|make) [^`]+)`(?!\s+at\s+commit\s+[0-9a-f]{8})"
)
A_PATH = re.compile(
    r"`((?:edge|fleet|firmware_protocol|training|bench|tests|tools|deploy|docs|examples)/[\w./-]+)`"
)
A_LENT_PARSER = re.compile(r"^from ([\w.]+) import (?:\([^)]*|.*)\bparser_of\b", re.MULTILINE)
LEAVE, PRINTED = "leave it running", "it prints"
SHELL = {"sh", "bash"}
FIGURE = r"(?<![\d.])\d+\.\d+"
LINKS_WITH_FIGURES = 18  # from the README's last sections into How it was measured
OTHERS = {  # whose options are not ours to check
    *(
        "systemctl",
        "git",
        "cp",
        "chgrp",
        "chmod",
        ".",
        "python",
        "apt",
        "dpkg",
        "adduser",
        "editor",
        "openssl",
        "/opt/greenhouse/venv/bin/pip",
        "ln",
        "createuser",
        "createdb",
        "sqlite3",
        "vmbackup",
    ),
}
TIME_MAX_S = 240.0  # of a processor that four tests share


@dataclass(frozen=True)
class CodeBlock:
    page: Path
    language: str
    title: str
    code: str

    @property
    def runs(self) -> bool:
        """True where a test can run it as it stands."""
        is_file = self.language == "python" and re.fullmatch(r"\w+\.py", self.title)
        return self.language in {*SHELL, "python"} and (not self.title or bool(is_file))

    @property
    def lines(self) -> list[list[str]]:
        """Words of each command."""
        whole = self.code.replace("\\\n", " ").splitlines()
        return [words for line in whole if (words := shlex.split(line, comments=True))]


def blocks(page: Path) -> list[CodeBlock]:
    return [CodeBlock(page, *found) for found in FENCE.findall(page.read_text(encoding="utf-8"))]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


ALL = [block for page in PAGES_BY_HAND for block in blocks(page)]
PARSED = [block for block in ALL if block.language in SHELL and block.title]
RUN = [page for page in PAGES_BY_HAND if any(block.runs for block in blocks(page))]


@contextmanager
def programs(folder: Path) -> Iterator[dict[str, str]]:
    """An environment in which `greenhouse` and `python` are this checkout's, with a folder for its demos."""
    own = {"greenhouse": "-m edge", "greenhouse-train": "-m training", "python": "", "python3": ""}
    for bin_ in (folder / "bin", folder / "reader" / ".venv" / "bin"):
        bin_.mkdir(parents=True)
        for name, module in own.items():
            (bin_ / name).write_text(f'#!/bin/sh\nexec {sys.executable} {module} "$@"\n')
            (bin_ / name).chmod(0o755)
    (folder / "tmp").mkdir()
    yield {
        **os.environ,
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "TMPDIR": str(folder / "tmp"),
    }


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder whose path leaves room for a socket's name."""
    with tempfile.TemporaryDirectory(prefix="gh-") as folder:
        yield Path(folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_the_code_of_a_page_runs(page: Path, short_path: Path) -> None:
    place = short_path / "reader"
    shutil.copytree(DOCS / "examples", place / "docs" / "examples")
    with programs(short_path) as environment, ExitStack() as running:
        printed = ""
        for block in blocks(page):
            if LEAVE in block.title:
                running.enter_context(left_running(block, place, environment))
            elif block.title == PRINTED:
                assert block.code.strip() == printed
            elif block.runs and block.language in SHELL:
                printed = output_of(["bash", "-e", "-c", block.code], place, environment)
            elif block.runs:
                (place / (block.title or "code.py")).write_text(block.code, encoding="utf-8")
                printed = output_of(["python", block.title or "code.py"], place, environment)


def output_of(command: list[str], place: Path, environment: dict[str, str]) -> str:
    """Return what a command prints. Fails where the command does."""
    done = subprocess.run(
        command, cwd=place, env=environment, capture_output=True, text=True, timeout=TIME_MAX_S, check=False
    )
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}{done.stderr}"
    return done.stdout.strip()


@contextmanager
def left_running(block: CodeBlock, place: Path, environment: dict[str, str]) -> Iterator[None]:
    """A command of the first terminal, from its first line of output until the page ends."""
    with subprocess.Popen(
        ["bash", "-c", f"exec {block.code}"], cwd=place, env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert "tick" in "".join(process.stdout.readline() for _ in range(3))
            yield
        finally:
            process.terminate()


@pytest.mark.parametrize("block", PARSED, ids=lambda block: f"{name_of(block.page)}: {block.title}")
def test_code_that_is_not_run_names_what_there_is(block: CodeBlock) -> None:
    for words in block.lines:
        check(words)


def check(words: list[str]) -> None:
    """Fail where a command, an option, a module, a target or a file does not exist."""
    while words[0] == "sudo" or re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        words = words[3:] if words[:2] == ["sudo", "-u"] else words[1:]
    for operator in ("&&", "|", ">"):
        if operator in words:
            at = words.index(operator)
            if operator != ">":
                check(words[at + 1 :])
            words = words[:at]
    program, rest = words[0].removeprefix(".venv/bin/"), words[1:]
    if program in PARSERS:
        PARSERS[program](rest)
    elif program == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert {word for word in rest if "=" not in word} <= set(targets), words
    elif program in ("python", "python3") and rest[0] == "-m":
        check_module(rest[1], rest[2:])
    elif program == "sh":
        assert (ROOT / rest[0]).exists(), words
    else:
        assert program in OTHERS, f"{program}: add it to OTHERS where it is not a command of this project"


def check_module(module: str, rest: list[str]) -> None:
    """Fail where the module is missing, or an option is in none of its files, nor in its parser's."""
    found = importlib.util.find_spec(module)
    assert found is not None and found.origin is not None, module
    if module.partition(".")[0] not in ("edge", "fleet", "training", "bench", "firmware_protocol", "tools"):
        return
    if module == "bench" and rest and not rest[0].startswith("-"):
        check_module(f"bench.{rest[0]}", rest[1:])
        return
    own = Path(found.origin)
    files = own.parent.rglob("*.py") if own.name == "__init__.py" else [own]
    source = "".join(path.read_text(encoding="utf-8") for path in files)
    if lender := A_LENT_PARSER.search(source):
        source += (ROOT / f"{lender[1].replace('.', '/')}.py").read_text(encoding="utf-8")
    for option in (word.partition("=")[0] for word in rest if word.startswith("--")):
        assert f'"{option}"' in source, f"{module} has no {option}"


def parse_greenhouse(words: list[str]) -> None:
    command = next((word for word in words if not word.startswith("-")), None)
    before, sys.argv = sys.argv, ["greenhouse", *words]  # by which `greenhouse fleet` knows its verb
    try:
        greenhouse.parser_for(command).parse_args(words)
    finally:
        sys.argv = before


def parse_training(words: list[str]) -> None:
    greenhouse_train._parser().parse_args(words)


PARSERS: dict[str, Callable[[list[str]], None]] = {
    "greenhouse": parse_greenhouse,
    "greenhouse-train": parse_training,
}


@pytest.mark.parametrize("page", PAGES_BY_HAND, ids=name_of)
def test_commands_within_a_line_exist(page: Path) -> None:
    for command in IN_A_LINE.findall(page.read_text(encoding="utf-8")):
        check_loosely(shlex.split(command))


def check_loosely(words: list[str]) -> None:
    """The same for a command whose arguments are words such as FILE, or are left out."""
    if words[0] in PARSERS:
        help_ = reference.help_of(words)
        for option in (word.partition("=")[0] for word in words if word.startswith("--")):
            assert option in help_, f"{words}: no {option}"
    else:
        check(words)


@pytest.mark.parametrize("page", [*PAGES_BY_HAND, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_files_within_a_line_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    written = {Path(title).name for _, title, _ in FENCE.findall(text)}  # by the reader, as the page tells
    named = [path for path in A_PATH.findall(text) if Path(path).name not in written]
    assert [path for path in named if not (ROOT / path).exists()] == []


@pytest.mark.parametrize(
    "block", [b for b in ALL if b.language == "yaml"], ids=lambda block: name_of(block.page)
)
def test_yaml_is_a_twin_file_or_settings(block: CodeBlock, tmp_path: Path) -> None:
    values = yaml.safe_load(block.code)
    if "effects" in values:
        (tmp_path / "twin.yaml").write_text(block.code, encoding="utf-8")
        read_twin_file(tmp_path / "twin.yaml")
    elif Path(block.title).name == "fleet.yaml":
        (tmp_path / "fleet.yaml").write_text(block.code, encoding="utf-8")
        load_fleet(tmp_path / "fleet.yaml")
    else:
        loading.parse(block.code, block.title)


@pytest.mark.parametrize("block", [b for b in ALL if b.language == "python"], ids=lambda b: name_of(b.page))
def test_python_that_is_not_run_is_python(block: CodeBlock) -> None:
    compile(block.code, block.title, "exec")


def anchor_of(heading: str) -> str:
    return re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")


def section(page: Path, anchor: str) -> str:
    """Text below the heading that has this anchor. Errors: KeyError where there is none"""
    _, *parts = re.split(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(map(anchor_of, parts[::2]), parts[1::2], strict=True))[anchor]


def test_figures_of_the_readme_stand_where_their_links_lead() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8").partition("## What is proven")[2]
    statements = re.findall(r"((?:[^\n]|\n  )*?)\]\((docs/measured/\w+\.md)#([^)]+)\)", readme)
    assert len(statements) == LINKS_WITH_FIGURES
    for text, page, anchor in statements:
        there = re.findall(FIGURE, section(ROOT / page, anchor))
        assert set(re.findall(FIGURE, text)) <= set(there), (text, anchor)


def test_links_of_the_readme_lead_somewhere() -> None:
    """Those of the manual are checked where it is built."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for path, anchor in re.findall(r"\]\(([^)#:]+)#?([^)]*)\)", readme):
        assert (ROOT / path).exists(), path
        assert not anchor or section(ROOT / path, anchor)
