"""`greenhouse-train networks`: tuned settings are used, other models are beside, costs are measured."""

import json
from pathlib import Path

import numpy as np
import pytest

from edge.formats.run_file import data_sha256
from edge.formats.table import Table
from training import __main__
from training.data.datasets import training_runs
from training.evaluate import network_comparison
from training.evaluate.network_comparison import FILE, errors_table
from training.models.study import SCENARIOS
from training.models.tuned_settings import FILE as TRIALS
from training.models.window_network import WindowSettings

ROOT = Path(network_comparison.__file__).parents[2]
EVALUATION = ROOT / "training" / "results" / "evaluation.json"


def write_trials(folder: Path, network: str) -> None:
    """Two trials on the runs of each regime; the second validates best, and it is quick."""
    rows = [
        {
            "network": network,
            "data": regime,
            "trial": number,
            "settings": {"epochs": 1, "hidden": hidden, "batch_size": 400},
            "seed": 100,
            "data_sha256": data_sha256(training_runs(regime)),
            "command": "",
            "validation_mae_k": 1.0 / hidden,
            "epochs": 1,
            "wall_s": 0.0,
        }
        for regime in SCENARIOS
        for number, hidden in enumerate((4, 8))
    ]
    folder.mkdir()
    (folder / TRIALS).write_text(json.dumps(rows))


def test_networks_are_trained_as_tuned_scored_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(network_comparison, "TURNS", 2)
    results, out = tmp_path / "networks", tmp_path / "out"
    write_trials(results, "tcn")
    words = ["networks", "--networks", "tcn", "--seeds", "1", "--results", str(results), "--out", str(out)]
    words += ["--box", str(tmp_path / "nowhere")]
    assert __main__.main(words) == 0
    rows = json.loads((results / FILE).read_text())
    assert [(row["model"], row["regime"], row["seed"]) for row in rows] == [
        ("tcn_tuned", "extrapolation", 1),
        ("tcn_tuned", "interpolation", 1),
    ]
    best = WindowSettings(epochs=1, hidden=8, batch_size=400)
    assert all(WindowSettings(**row["settings"]) == best for row in rows)
    printed = capsys.readouterr().out
    assert (results / "networks.txt").read_text() in printed
    # The table of errors comes first, so its lines are the last to be taken.
    lines = [line for line in reversed(printed.splitlines()) if line.strip()]
    table = {line.split("  ")[0]: line.split() for line in lines}
    assert {"linear", "lstm", "ham_guarded", "tcn_tuned", "lstm, general graph"} <= table.keys()
    maes = [row["free_run"]["mae_k"] for row in rows[1]["scenarios"].values()]
    assert float(table["tcn_tuned"][4]) == pytest.approx(np.mean(maes), abs=6e-4)
    # Without a training the same records give the same figures.
    monkeypatch.setattr(network_comparison, "costs_table", lambda arguments, found: Table("", ("",), ()))
    assert __main__.main([*words, "--kept"]) == 0
    assert json.loads((results / FILE).read_text()) == rows


def test_the_other_models_are_those_of_the_evaluation() -> None:
    # Mean and sd of the LSTM's five seeds, as the evaluation's own table has them.
    row = next(row for row in errors_table([], EVALUATION).rows if row[0] == "lstm")
    committed = (EVALUATION.parent / "evaluation.txt").read_text()
    assert row[4] in committed and row[8] in committed
    assert len(row) == 9


def test_a_network_without_trials_is_not_trained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["networks", "--networks", "gru", "--results", str(tmp_path), "--out", str(tmp_path / "out")]
    assert __main__.main(words) == 2
    assert "greenhouse-train tune-networks --networks gru" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
