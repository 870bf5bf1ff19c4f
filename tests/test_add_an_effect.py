"""docs/add-an-effect.md: its excerpts are the library's own code, its search prints what the page says.

`test_manual` runs the page's other code.
"""

import re
import sys
from pathlib import Path
from unittest.mock import patch

import pytest
from notebooks import short_example

from edge.twin.effects.library import EFFECTS
from tests.support.simulated_runs import candidates_only

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/add-an-effect.md").read_text(encoding="utf-8")
EXCERPTS = re.findall(r"^```text\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
TITLED = dict(re.findall(r'^```\w+ title="([^"]*)"\n(.*?)^```$', PAGE, re.DOTALL | re.MULTILINE))
EXAMPLE = (
    "edge/twin/effects/named.py",
    "tests/edge/twin/test_twin_effects.py",
    "tests/support/twin_equations.py",
)


@pytest.mark.parametrize("block", EXCERPTS)
def test_the_example_is_the_code_of_this_repository(block: str) -> None:
    pieces = [piece.strip("\n") for piece in block.split("\n\n\n")]
    sources = [(ROOT / path).read_text(encoding="utf-8") for path in EXAMPLE]
    assert all(any(piece in source for source in sources) for piece in pieces)


@pytest.mark.slow
def test_the_search_prints_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my_effect.py").write_text(TITLED["my_effect.py"], encoding="utf-8")
    short_example(tmp_path, 2, 60)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with patch.dict(EFFECTS), candidates_only("heater_lag", "infiltration", "sensor_lag"):
        exec(TITLED["seek.py, less than a minute"], {})
    del sys.modules["my_effect"]
    assert capsys.readouterr().out == TITLED["seek.py prints"]
