"""edge/diagnosis/python.py: the diagnosis from five lines of Python, and the notebook that shows them."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from notebooks import names_left_by, short_example

import edge
from edge import DiagnosisResult, Run, Twin, diagnose
from edge.core.errors import DataError
from tests.support.simulated_runs import candidates_only

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "docs" / "examples" / "diagnosis"
NOTEBOOK = ROOT / "examples" / "diagnosis.ipynb"


@pytest.fixture(scope="module")
def notebook(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the names that the notebook's cells leave behind, on the first hour of two recordings."""
    folder = tmp_path_factory.mktemp("notebook")
    short_example(folder, 2, 60)
    with candidates_only("heater_lag", "infiltration", "sensor_lag", "soil_mass"):
        return names_left_by(NOTEBOOK, folder)


@pytest.fixture(scope="module")
def found(notebook: dict[str, Any]) -> DiagnosisResult:
    result = notebook["found"]
    assert isinstance(result, DiagnosisResult)
    return result


def test_five_lines_find_what_is_missing(found: DiagnosisResult, tmp_path: Path) -> None:
    assert found.verdict == "named"
    assert set(found.names) == {"heater_lag", "infiltration"}
    assert all(0.5 < probability <= 1.0 for probability in found.names.values())
    assert "Two effects are missing" in str(found)
    assert found.twin is not None
    found.twin.write(tmp_path / "twin.yaml")
    assert Twin.read(tmp_path / "twin.yaml").file.effects.keys() == found.twin.file.effects.keys()


def test_the_new_twin_predicts_a_run_that_it_never_saw(found: DiagnosisResult) -> None:
    run = Run.read(EXAMPLE / "test_1.csv")
    assert found.twin is not None
    missed = run.content.columns["temp_air_c"] - found.twin.predict(run)
    assert missed.shape == (len(run),)
    assert np.sqrt(np.mean(missed**2)) < 0.1


def test_a_notebook_shows_tables(found: DiagnosisResult) -> None:
    assert "<td>heater_lag</td>" in found._repr_html_()
    assert "<td>temp_air_c</td>" in Run.read(EXAMPLE / "test_1.csv")._repr_html_()
    assert "<td>effects.wall_loss.UA</td>" in Twin.read(EXAMPLE / "twin.yaml")._repr_html_()


def test_a_report_is_a_folder(found: DiagnosisResult, tmp_path: Path) -> None:
    page = found.report(tmp_path / "report")
    assert page.exists()
    document = json.loads((page.parent / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["verdict"] == "named"


def test_arrays_do_as_well_as_files() -> None:
    run = Run.read(EXAMPLE / "train_1.csv")
    same = Run.of(run.content.columns, "train_1.csv", **run.content.facts)
    assert np.array_equal(same.content.columns["temp_air_c"], run.content.columns["temp_air_c"])
    assert same.content.start_utc == run.content.start_utc


def test_what_is_missing_is_named() -> None:
    twin = Twin.read(EXAMPLE / "twin.yaml")
    with pytest.raises(DataError, match="box: heater_duty: missing"):
        diagnose(twin, [Run.of({"time_s": [0.0, 60.0], "temp_air_c": [20.0, 21.0]}, "box")])
    with pytest.raises(DataError, match="temp_ambient_c: missing"):
        twin.predict(Run.of({"time_s": [0, 60], "temp_air_c": [20, 21], "heater_duty": [0, 1]}, "box"))


def test_the_daemon_imports_none_of_it() -> None:
    modules = "'edge.diagnosis.python' in sys.modules, 'scipy' in sys.modules"
    code = f"import edge, sys; print(edge.__version__, {modules})"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert told.stdout.split()[1:] == ["False", "False"]
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = edge.nothing_like_it


def test_the_notebook_runs(notebook: dict[str, Any]) -> None:
    assert notebook["found"].verdict == "named"
    assert float(notebook["rmse_k"]) < 0.1
