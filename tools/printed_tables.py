"""Tables that commands have printed into bench/results and training/results, as one page of the manual."""

import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDERS = ("bench/results", "training/results")
TABLES_PAGE = "measured/printed.md"
HEAD = """---
search: {exclude: true}
---

# Tables as printed

The files below are what the commands have printed. Most begin with the command, the commit and the machine.
"""


@cache
def results() -> tuple[str, ...]:
    """Return the paths of all tables, from the root of the repository."""
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.txt")]
    return tuple(sorted(path.relative_to(ROOT).as_posix() for path in found))


def anchor(path: str) -> str:
    """Return the anchor of a table on the page."""
    return path.removesuffix(".txt").replace("/", "-").replace("_", "-")


def printed_tables() -> str:
    """Return the page."""
    parts = [HEAD]
    for path in results():
        text = (ROOT / path).read_text(encoding="utf-8").rstrip()
        parts += [
            f"## {path} {{ #{anchor(path)} }}",
            "",
            _last_change(path),
            "",
            "````text",
            text,
            "````",
            "",
        ]
    return "\n".join(parts)


def _last_change(path: str) -> str:
    """Return which commit wrote a table; a copy of the sources without git says nothing."""
    command = ["git", "log", "-1", "--format=%h of %as", "--", path]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    return f"Written by commit {found}." if found else ""
