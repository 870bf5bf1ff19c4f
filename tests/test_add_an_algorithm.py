"""docs/add-an-algorithm.md: its example learns, is exported, and is read as a rig reads it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/add-an-algorithm.md").read_text(encoding="utf-8")
TITLED = dict(re.findall(r'^```\w+ title="([^"]*)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))


@pytest.mark.slow
def test_the_example_prints_what_the_page_says(tmp_path: Path) -> None:
    for name in ("climb.py", "try.py, in the checkout"):
        (tmp_path / name.partition(",")[0]).write_text(TITLED[name], encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(tmp_path / "try.py")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == TITLED["try.py prints"], done.stderr
