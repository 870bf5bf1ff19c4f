"""The report: its tables, its pictures, and the findings that a person has written."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from comparison_figures import MISSED_K, all_scored, costs, evaluation

from training.data.datasets import test_run as run_of
from training.models.rollout import START_ROWS
from training.reports.comparison_report import report
from training.reports.report_pictures import (
    INNERMOST,
    bars_picture,
    radar_picture,
    radar_radii,
    scenario_picture,
)
from training.reports.report_tables import costs_table, tables

ROOT = Path(__file__).parents[3]
FOUND = all_scored()
WORDS = "# Ours\n\n**Said.** *Holds.* a < b\n\nAnd more."
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def page() -> str:
    return report(evaluation(FOUND), costs(), {"scenario_1": b"one", "models_radar": b"two"}, WORDS)


def test_the_report_holds_every_section_table_and_picture(page: str) -> None:
    assert "<p><b>Said.</b> <em>Holds.</em> a &lt; b</p>\n<p>And more.</p>" in page
    for title in ("Ours", "Figures", "Pictures"):
        assert f"<h2>{title}</h2>" in page
    for table in (*tables(evaluation(FOUND)), costs_table(costs())):
        assert f"<h3>{table.title}</h3>" in page.replace("&#x27;", "'")
    assert re.findall(r'alt="(\w+)"', page) == ["scenario_1", "models_radar"]


def test_the_report_needs_nothing_beside_it(page: str) -> None:
    assert "http" not in page
    assert "<script" not in page and "<link" not in page
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="([^"]+)"', page))


def test_the_report_is_well_formed(page: str) -> None:
    for tag in ("table", "tr", "p", "h2", "h3", "b", "body", "html"):
        assert len(re.findall(rf"<{tag}[ >]", page)) == page.count(f"</{tag}>"), tag


def test_the_first_table_holds_mean_and_spread_over_the_seeds() -> None:
    rows = {row[0]: row for row in tables(evaluation(FOUND))[0].rows}
    assert rows["Linear"][1:5] == ("1.000",) * 4
    # 0.5 and 0.505 K: mean 0.5025, sd 0.0025 sqrt(2)
    assert rows["LSTM"][1] == "0.502 ± 0.004"
    assert len(rows) == len(MISSED_K)


def test_radar_radii_are_logarithmic_between_the_best_and_the_worst() -> None:
    radii = radar_radii([1.0, 10.0, 100.0])
    assert radii == pytest.approx([INNERMOST, 0.5 * (INNERMOST + 1.0), 1.0])


def test_equal_values_lie_on_one_ring() -> None:
    assert radar_radii([3.0, 3.0]).tolist() == [INNERMOST, INNERMOST]


def test_pictures_are_pictures() -> None:
    run = run_of(2)
    measured = run.columns["temp_air_c"][START_ROWS:]
    forecasts = {"lstm": [measured, measured + 0.5], "pbm": [np.linspace(25.0, 500.0, len(measured))]}
    pictures = [
        scenario_picture(run, forecasts, "Scenario 2"),
        bars_picture([one.score for one in FOUND], "extrapolation"),
        radar_picture([one.score for one in FOUND], costs()),
    ]
    for picture in pictures:
        assert picture.startswith(PNG)
        assert 3_000 < len(picture) < 150_000  # a blank one has less, and they lie in the repository
    assert pictures[0] == scenario_picture(run, forecasts, "Scenario 2")


def test_a_model_is_measured_without_torch_in_the_process() -> None:
    twin = ROOT / "training/results/trained/twin/interpolation/seed_0/twin.yaml"
    code = (
        "import sys; from training.evaluate.edge_process import main; "
        f"main(['pbm', {str(twin)!r}]); assert 'torch' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert '"ran_mib"' in done.stdout
