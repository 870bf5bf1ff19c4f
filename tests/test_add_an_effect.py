"""docs/add-an-effect.md: its scripts print what the page says, and its example is the library's own code."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/add-an-effect.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
CODE = [text for language, text in BLOCKS if language == "python"]
PRINTED = [text for language, text in BLOCKS if language == ""]
EXCERPTS = [text for language, text in BLOCKS if language == "text"]
SCRIPTS = {"my_effect.py": CODE[0], "check.py": CODE[1], "seek.py": CODE[2]}
EXAMPLE = (
    "edge/twin/effects/signal.py",
    "tests/edge/twin/test_twin_effects.py",
    "tests/support/twin_equations.py",
)


@pytest.mark.parametrize(("name", "printed"), [("check.py", PRINTED[0]), ("seek.py", PRINTED[1])])
def test_a_script_prints_what_the_page_says(name: str, printed: str, tmp_path: Path) -> None:
    for file, text in SCRIPTS.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / name)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == printed, done.stderr


def test_the_twin_file_acts_as_the_page_says(tmp_path: Path) -> None:
    (shell,) = (text for language, text in BLOCKS if language == "sh" and "living.yaml" in text)
    shell = shell.replace("/tmp/living.yaml", str(tmp_path / "living.yaml"))
    shell = shell.replace(".venv/bin/python", sys.executable)
    done = subprocess.run(["sh", "-c", shell], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout == PRINTED[2], done.stderr


@pytest.mark.parametrize("block", EXCERPTS)
def test_the_example_is_the_code_of_this_repository(block: str) -> None:
    pieces = [piece.strip("\n") for piece in block.split("\n\n\n")]
    sources = [(ROOT / path).read_text(encoding="utf-8") for path in EXAMPLE]
    assert all(any(piece in source for source in sources) for piece in pieces)
