"""bench/reliability.py: what is counted and drawn."""

import json
from pathlib import Path

import pytest

from bench.reliability import main


def answered(folder: Path, names: dict[str, float], hidden: str) -> None:
    """A case with its truth, and an answer whose names have these probabilities."""
    for path, content in (
        (folder / "truth" / "case_1.json", {"hidden": {hidden: {}}}),
        (
            folder / "answers" / "case_1" / "diagnosis.json",
            {"effects": [{"name": name, "probability": said} for name, said in names.items()]},
        ),
    ):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(content), encoding="utf-8")


def test_what_was_said_stands_beside_what_held(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answered(tmp_path / "dev", {"heater_lag": 0.97, "soil_mass": 0.7}, hidden="heater_lag")
    assert main([f"foreign={tmp_path / 'dev'}", "--out", str(tmp_path / "diagram.png")]) == 0
    said = capsys.readouterr().out
    assert "foreign: 2 names" in said
    assert "0.95 to 1.00: said 0.97, held 1.00" in said
    assert "0.60 to 0.80: said 0.70, held 0.00" in said
    assert (tmp_path / "diagram.png").stat().st_size > 1000


def test_a_place_without_names_draws_an_empty_diagram(tmp_path: Path) -> None:
    (tmp_path / "dev" / "truth").mkdir(parents=True)
    assert main([f"foreign={tmp_path / 'dev'}", "--out", str(tmp_path / "diagram.png")]) == 0
    assert (tmp_path / "diagram.png").stat().st_size > 1000
