"""Other people's code is what it was, and all of the page is small."""

import gzip
import hashlib
import re

from edge.page.app import STATIC

GZIP_MAX = 61_000  # bytes, of all that a browser loads


def test_code_of_others_is_as_it_was_published() -> None:
    text = (STATIC / "vendor" / "README.md").read_text(encoding="utf-8")
    known = dict(re.findall(r"^\| (\S+) \|.*\| ([0-9a-f]{64}) \|$", text, re.MULTILINE))
    files = {path for path in (STATIC / "vendor").iterdir() if path.suffix in (".js", ".css")}
    assert {path.name for path in files} == set(known)
    for path in files:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == known[path.name], path.name
    for name in ("uplot", "preact", "htm"):
        assert (STATIC / "vendor" / f"LICENSE.{name}.txt").stat().st_size > 500


def test_what_a_browser_loads_is_small() -> None:
    loaded = [path for path in STATIC.rglob("*") if path.suffix in (".html", ".js", ".css", ".svg")]
    assert sum(len(gzip.compress(path.read_bytes(), 6)) for path in loaded) < GZIP_MAX


def test_nothing_is_loaded_from_elsewhere_and_no_text_becomes_html() -> None:
    for path in STATIC.glob("*.*"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"""(src|href|from|import)\s*[=(]?\s*["']https?:""", text), path.name
        assert "innerHTML" not in text
        assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+\s*=\s*[\"']|style=\"", text), path.name
