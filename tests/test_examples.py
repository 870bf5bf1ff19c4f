"""examples/: the notebooks hold no results of their own, are linked in the manual, and run.

`examples/diagnosis.ipynb` is run by tests/edge/diagnosis/test_python.py.
"""

from pathlib import Path

import pytest
from notebooks import NOTEBOOKS, ROOT, cells_of, names_left_by

EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_results(notebook: Path) -> None:
    code = [cell for cell in cells_of(notebook) if cell["cell_type"] == "code"]
    assert code
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"] is not None] == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_manual_leads_to_a_notebook(notebook: Path) -> None:
    pages = (ROOT / "docs").glob("*.md")
    assert any(f"](../examples/{notebook.name})" in page.read_text(encoding="utf-8") for page in pages)


@pytest.mark.slow
def test_the_step_tests_give_a_twin_that_forecasts(tmp_path: Path) -> None:
    left = names_left_by(EXAMPLES / "step_test.ipynb", tmp_path)
    assert left["rmse_k"] < 0.15  # the sensor's steps are 0.1 K
    assert left["values_alone"] < 0.6 < 0.95 < left["with_errors"]  # as its text says


@pytest.mark.slow
def test_the_pid_is_better_than_rules(tmp_path: Path) -> None:
    results = names_left_by(EXAMPLES / "pid.ipynb", tmp_path)["results"]
    assert set(results) == {"my PID", "PID", "rules"}
    assert results["my PID"]["cost"] < results["rules"]["cost"]
    assert results["PID"]["cost"] < results["rules"]["cost"]


@pytest.mark.slow
def test_the_search_finds_a_cheaper_policy(tmp_path: Path) -> None:
    left = names_left_by(EXAMPLES / "gym_loop.ipynb", tmp_path)
    assert 0.0 < left["after"] < 0.8 * left["before"]
    assert left["others"] < left["before"]
