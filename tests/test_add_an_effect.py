"""docs/add-an-effect.md: its excerpts are the library's own code, its search prints what the page says.

`test_manual` runs the page's other code.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/add-an-effect.md").read_text(encoding="utf-8")
EXCERPTS = re.findall(r"^```text\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
TITLED = dict(re.findall(r'^```\w+ title="([^"]*)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))
EXAMPLE = (
    "edge/twin/effects/signal.py",
    "edge/twin/effects/loss.py",
    "tests/edge/twin/test_twin_effects.py",
    "tests/support/twin_equations.py",
)


@pytest.mark.parametrize("block", EXCERPTS)
def test_the_example_is_the_code_of_this_repository(block: str) -> None:
    pieces = [piece.strip("\n") for piece in block.split("\n\n\n")]
    sources = [(ROOT / path).read_text(encoding="utf-8") for path in EXAMPLE]
    assert all(any(piece in source for source in sources) for piece in pieces)


@pytest.mark.slow
def test_the_search_prints_what_the_page_says(tmp_path: Path) -> None:
    for name, title in (("my_effect.py", "my_effect.py"), ("seek.py", "seek.py, less than a minute")):
        (tmp_path / name).write_text(TITLED[title], encoding="utf-8")
    command = [sys.executable, str(tmp_path / "seek.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == TITLED["seek.py prints"], done.stderr
