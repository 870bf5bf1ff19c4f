"""MkDocs hook of the manual: generated pages, pages and pictures that stand elsewhere, links to the code.

A page links to a file of the repository by its relative path, which works in a checkout and on a forge. In
the built manual such a link leads to the page made of that file, or becomes the file's path in code letters.
A path that does not exist is a warning, which `mkdocs build --strict` refuses.
"""

import logging
import posixpath
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from tools.reference import PAGES

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


ELSEWHERE = {  # page or picture of the manual -> its file in the repository
    "deploy.md": "deploy/README.md",
    "wire-protocol.md": "firmware_protocol/PROTOCOL.md",
    "c-firmware.md": "firmware_protocol/c/README.md",
    "virtual-board.md": "firmware_protocol/virtual_board/README.md",
    "chamber.md": "firmware_protocol/virtual_board/CHAMBER.md",
    "recorded-runs.md": "training/data/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "baselines.md": "training/results/control/baselines.md",
    "findings.md": "training/results/control/findings.md",
    "images/waterfall.png": "training/results/paper_case/waterfall.png",
}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
FOREIGN = re.compile(
    r"<(?:script|img|iframe|link(?! rel=\"canonical\"))[^>]* (?:src|href)=\"?(https?:[^\" >]*)"
)
log = logging.getLogger("mkdocs.hooks.manual")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated reference and what stands elsewhere."""
    for name, page in PAGES.items():
        files.append(File.generated(config, f"reference/{name}", content=page()))
    files.append(File.generated(config, TABLES_PAGE, content=printed_tables()))
    for name, path in ELSEWHERE.items():
        if files.get_file_from_path(name) is None:
            files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Lead links to files of the repository to where a reader of the built manual finds them."""
    source = page.file.src_uri
    origin = ELSEWHERE.get(source, posixpath.join("docs", source))

    def led(found: "re.Match[str]") -> str:
        bang, text, target = found.groups()
        path, hash_, fragment = target.partition("#")
        if not path or "://" in path or path.startswith("mailto:"):
            return found[0]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))
        inside = _manual_path(file, files)
        if file in results():
            hash_, fragment = "#", anchor(file)
        if file.removeprefix("docs/") in ELSEWHERE:
            log.warning("%s: link to the file itself, %s", source, ELSEWHERE[file.removeprefix("docs/")])
        if inside is not None:
            away = posixpath.relpath(inside, posixpath.dirname(source) or ".")
            return f"{bang}[{text}]({away}{hash_}{fragment})"
        if not (ROOT / file).exists():
            log.warning("%s: %s is not in the repository", source, target)
        return f"`{file}`" if text.strip("`") == file else f"{text}: `{file}`"

    return LINK.sub(led, markdown)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """Warn of a page that would load anything from another server."""
    for address in FOREIGN.findall(output):
        log.warning("%s: loads %s", page.file.src_uri, address)
    return output


def _manual_path(file: str, files: Files) -> str | None:
    """Return the manual's path of a file of the repository, None where the manual does not hold it."""
    if file in results():
        return TABLES_PAGE
    for name, path in ELSEWHERE.items():
        if path == file:
            return name
    inside = file.removeprefix("docs/")
    return inside if inside != file and files.get_file_from_path(inside) is not None else None
