"""The comparison: scores out of kept weights, what is kept and compared, and the report of it."""

import argparse
import json
import math
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from comparison_figures import MISSED_K, all_scored, costs, evaluation, score
from training_runs import box_run

from edge.core.errors import DataError
from training import __main__
from training.data.datasets import test_run as run_of
from training.evaluate import ablation, scores
from training.evaluate import evaluation as command
from training.evaluate.difference import first_difference
from training.evaluate.evaluation import ELSEWHERE_K, MACHINE_FILE, json_of
from training.evaluate.pictures import (
    INNERMOST,
    bars_picture,
    radar_picture,
    radar_radii,
    scenario_picture,
)
from training.evaluate.report import costs_table, report, tables
from training.evaluate.scores import TrainingScore, by_seed, maes, orders, score_runs
from training.models.rollout import START_ROWS
from training.models.saved_training import SavedTraining, read_trained, remove_guard, without_weights
from training.models.summary import best_seed

ROOT = Path(__file__).parents[3]
RESULTS = ROOT / "training" / "results"


@pytest.fixture(scope="module")
def kept() -> list[SavedTraining]:
    torch.set_num_threads(1)
    return read_trained(RESULTS / "trained")


def of(kept: list[SavedTraining], model: str, regime: str, seed: int = 0) -> SavedTraining:
    return next(one for one in kept if (one.model, one.regime, one.seed) == (model, regime, seed))


def test_scores_out_of_the_kept_weights_are_those_committed(kept: list[SavedTraining]) -> None:
    committed = json.loads((RESULTS / "evaluation.json").read_text())["scores"]
    mine = list({one.model: one for one in kept if one.regime == "interpolation"}.values())
    assert {one.model for one in mine} >= {"lstm", "ham", "ham_guarded"}
    guarded = next(one for one in mine if one.model == "ham_guarded")
    for found in score_runs([*mine, remove_guard(guarded)], scenarios=[2]):
        now = json.loads(json.dumps(asdict(found.score)))
        same = [
            row for row in committed if all(row[key] == now[key] for key in ("model", "seed", "scenario"))
        ]
        assert len(same) == 1
        assert first_difference(same[0], now, ELSEWHERE_K) == ""


def test_every_seed_is_recorded_and_the_weights_are_there_but_for_most_lstms(
    kept: list[SavedTraining],
) -> None:
    absent = without_weights(RESULTS / "trained")
    assert {folder.parts[-3] for folder in absent} == {"lstm", "lstm_increment"}
    records = [json.loads(path.read_text()) for path in (RESULTS / "trained").glob("*/*/*/result.json")]
    assert len({(row["model"], row["regime"]) for row in records}) == 18  # 9 models in 2 regimes
    for model in ("lstm", "ham", "lstm_increment", "ham_guarded"):
        for regime in ("interpolation", "extrapolation"):
            every = {row["seed"] for row in records if (row["model"], row["regime"]) == (model, regime)}
            assert every == {0, 1, 2, 3, 4}
    assert [one.seed for one in kept if one.model == "lstm"] == [best_seed(records, "lstm", "interpolation")]


def test_tables_are_not_written_from_a_part_of_the_trainings(
    small: argparse.Namespace, capsys: pytest.CaptureFixture[str]
) -> None:
    command.run(small)
    absent = small.trained / "lstm" / "interpolation" / "seed_1"
    absent.mkdir(parents=True)
    (absent / "result.json").write_text("{}")
    with pytest.raises(DataError, match=r"seed_1: no weights; `greenhouse-train all` trains this and 0 more"):
        command.run(small)
    small.check = True
    assert command.run(small) == 0
    assert "1 trainings are recorded without their weights" in capsys.readouterr().out


def test_our_hybrid_extrapolates_better_than_the_papers_and_the_lstm_with_every_seed() -> None:
    rows = [_score(row) for row in json.loads((RESULTS / "evaluation.json").read_text())["scores"]]
    worst = maes(rows, "ham_guarded", "extrapolation").mean(axis=1).max()
    assert worst < maes(rows, "ham", "extrapolation").mean(axis=1).min()
    assert worst < maes(rows, "lstm", "extrapolation").mean(axis=1).min()


def _score(row: dict[str, Any]) -> TrainingScore:
    return score(row["model"], row["regime"], row["seed"], row["scenario"], row["free_run"]["mae_k"])


def test_a_training_on_other_runs_is_refused(kept: list[SavedTraining]) -> None:
    other = of(kept, "pbm", "interpolation")
    other = replace(other, record={**other.record, "data_sha256": "0" * 64})
    with pytest.raises(DataError, match="data_sha256"):
        score_runs([other])


def test_a_missing_training_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="linear/interpolation: no training"):
        read_trained(tmp_path)


def test_a_record_that_lies_elsewhere_is_refused(tmp_path: Path, kept: list[SavedTraining]) -> None:
    folder = tmp_path / "linear" / "extrapolation" / "seed_0"
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps(of(kept, "linear", "interpolation").record))
    (folder / "arx.json").write_text("{}")
    with pytest.raises(DataError, match="regime: 'interpolation'"):
        read_trained(tmp_path)


def test_without_its_guard_the_hybrid_differs_outside_its_box_alone(kept: list[SavedTraining]) -> None:
    guarded = of(kept, "ham_guarded", "extrapolation")
    free = remove_guard(guarded)
    low, high = guarded.record["validity"]["temp_air_c"]
    for temp, same in ((0.5 * (low + high), True), (high + 3.0, False)):
        history = {"temp_air": np.full(10, temp), "temp_ambient": np.full(10, 22.0)}
        history |= {"heater_duty": np.full(10, 0.4), "fan_on": np.zeros(10)}
        controls, ahead = np.array([[[0.4, 0.0]]]), {"temp_ambient": np.array([22.0])}
        one, other = (kind.predictor.rollout(history, controls, ahead)[0, 0] for kind in (guarded, free))
        assert (one == other) == same


def test_only_the_guarded_hybrid_has_a_guard(kept: list[SavedTraining]) -> None:
    with pytest.raises(DataError, match="no guard"):
        remove_guard(of(kept, "ham", "extrapolation"))


def test_orders_are_counted_by_seed() -> None:
    means = {"linear": [0.6], "pbm": [9.0], "lstm": [0.5, 0.7, 0.4], "ham": [3.0, 0.1, 3.0]}
    rows = [
        score(model, "interpolation", seed, scenario, mae)
        for model, column in means.items()
        for seed, mae in enumerate(column)
        for scenario in (1, 2, 3)
    ]
    assert orders(rows, "interpolation") == {
        ("lstm", "linear", "ham", "pbm"): 2,
        ("ham", "linear", "lstm", "pbm"): 1,
    }


def test_a_model_with_some_of_the_seeds_is_refused() -> None:
    rows = [score("lstm", "interpolation", seed, number, 1.0) for seed in (0, 1) for number in (1, 2, 3)]
    assert by_seed(rows, "lstm", "interpolation", 2).tolist() == [1.0, 1.0]
    with pytest.raises(DataError, match="2 seeds of 5"):
        by_seed(rows, "lstm", "interpolation", 5)


@pytest.mark.parametrize(
    ("one", "other", "tolerance", "place"),
    [
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.0]}, 0.0, ""),
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.5]}, 0.0, "evaluation.json.a.1"),
        ({"a": 1.0}, {"a": 1.5}, 0.5, ""),
        ({"a": 1.0}, {"a": math.nextafter(1.5, 2.0)}, 0.5, "evaluation.json.a"),
        ({"a": 1.0}, {"a": math.nan}, 0.5, "evaluation.json.a"),
        ({"a": None}, {"a": 0.0}, 0.5, "evaluation.json.a"),
        ({"a": True}, {"a": 1.0}, 0.5, ""),
        ({"a": "x"}, {"a": "y"}, 0.5, "evaluation.json.a"),
        ({"a": 1}, {"b": 1}, 0.0, "evaluation.json"),
        ([1, 2], [1], 0.0, "evaluation.json"),
    ],
)
def test_the_first_difference_is_named(one: Any, other: Any, tolerance: float, place: str) -> None:
    assert first_difference(one, other, tolerance).split(":")[0] == place


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> argparse.Namespace:
    """The command over made-up figures."""
    figures = evaluation(found := all_scored())
    monkeypatch.setattr(command, "read_trained", lambda root: [])
    monkeypatch.setattr(command, "score_runs", lambda trainings: found)
    monkeypatch.setattr(command, "unexplained_errors", lambda: list(figures.unexplained))
    monkeypatch.setattr(command, "bases", lambda: list(figures.bases))
    monkeypatch.setattr(command, "swap_models", lambda trainings, model: list(figures.swapped))
    monkeypatch.setattr(command, "by_excess", lambda trainings, model: list(figures.by_excess))
    monkeypatch.setattr(command, "costs", lambda trainings: costs())
    monkeypatch.setattr(command, "pictures_of", lambda found, cost: {"one": b"picture"})
    return argparse.Namespace(
        trained=tmp_path,
        results=tmp_path / "results",
        images=tmp_path / "images",
        check=False,
        tolerance=None,
    )


def change_first_score(small: argparse.Namespace, by_k: float) -> None:
    path = small.results / "evaluation.json"
    document = json.loads(path.read_text())
    document["scores"][0]["free_run"]["mae_k"] += by_k
    path.write_text(json.dumps(document))


def test_what_was_evaluated_passes_its_own_check(small: argparse.Namespace) -> None:
    assert command.run(small) == 0
    small.check = True
    assert command.run(small) == 0


@pytest.mark.parametrize(
    ("elsewhere", "difference_k", "code"),
    [(False, 2e-7, 1), (True, 2e-7, 0), (True, 0.9e-3, 0), (True, 1.1e-3, 1), (True, math.nan, 1)],
)
def test_the_same_machine_is_held_to_the_last_bit_and_another_to_a_thousandth_of_a_kelvin(
    small: argparse.Namespace,
    capsys: pytest.CaptureFixture[str],
    elsewhere: bool,
    difference_k: float,
    code: int,
) -> None:
    command.run(small)
    change_first_score(small, difference_k)
    if elsewhere:
        (small.results / MACHINE_FILE).write_text(json.dumps({**command.machine(), "cpu": "another"}))
    small.check = True
    assert command.run(small) == code
    assert ("made on another machine" if elsewhere else "made on this machine") in capsys.readouterr().out


def test_without_the_name_of_its_machine_a_table_is_another_machines(small: argparse.Namespace) -> None:
    command.run(small)
    (small.results / MACHINE_FILE).unlink()
    (small.results / "evaluation.txt").write_text("other fonts")
    small.check = True
    assert command.run(small) == 0


def test_a_changed_figure_fails_the_check_unless_tolerated(
    small: argparse.Namespace, capsys: pytest.CaptureFixture[str]
) -> None:
    command.run(small)
    change_first_score(small, 1e-4)
    small.check = True
    assert command.run(small) == 1
    assert "evaluation.json.scores.0.free_run.mae_k: 1.0001 is kept, now 1.0" in capsys.readouterr().out
    small.tolerance = 1e-3
    assert command.run(small) == 0


def test_a_changed_file_fails_the_check(small: argparse.Namespace) -> None:
    command.run(small)
    (small.results / "evaluation.txt").write_text("other")
    small.check = True
    assert command.run(small) == 1


def test_the_command_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[argparse.Namespace] = []
    monkeypatch.setattr(command, "run", lambda arguments: given.append(arguments) or 1)
    assert __main__.main(["evaluate", "--check", "--tolerance", "0.001"]) == 1
    assert (given[0].check, given[0].tolerance) == (True, 0.001)


def test_figures_keep_all_their_digits() -> None:
    figures = evaluation(all_scored())
    assert json.loads(json_of(figures)) == json.loads(json.dumps(asdict(figures)))


def test_past_duties_explain_what_a_lagging_heater_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        ablation, "training_runs", lambda regime: [box_run(seed, rows=150) for seed in range(6)]
    )
    room, air, past = ablation.unexplained_errors()
    # The box of these runs has a heater that lags by 300 s: five steps of duty are in its air.
    assert past.fan_off_k < 0.5 * air.fan_off_k < 0.5 * room.fan_off_k
    assert past.fan_on_k < 0.5 * air.fan_on_k


def test_a_base_is_judged_on_validation_parts_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [box_run(seed, rows=100) for seed in range(3)]
    judged: list[str] = []
    monkeypatch.setattr(ablation, "training_runs", lambda regime: runs)
    monkeypatch.setattr(ablation, "BASES", {"bare": ()})

    def noted(predictor: Any, parts: Any) -> float:
        judged.extend(part.facts["role"] for part in parts)
        return 1.0

    monkeypatch.setattr(ablation, "mean_free_run_mae", noted)
    assert ablation.bases(seeds=(0,)) == [ablation.Base("bare", 1, 1.0, (1.0,))]
    assert set(judged) == {"validate"}


def test_both_twins_forecast_all_test_runs(kept: list[SavedTraining]) -> None:
    found = scores.swap_models([one for one in kept if one.model == "pbm"], "pbm")
    assert [one.regime for one in found] == ["interpolation", "extrapolation"]
    # Nothing is fitted in the paper's PBM: it is the same in both regimes.
    assert found[0].bias_k == found[1].bias_k


def test_the_bias_is_told_by_the_excess_over_the_room(
    monkeypatch: pytest.MonkeyPatch, kept: list[SavedTraining]
) -> None:
    run = box_run(0)
    excess = run.columns["temp_air_c"] - run.columns["temp_ambient_c"]
    monkeypatch.setattr(ablation, "training_runs", lambda regime: [run])
    monkeypatch.setattr(ablation, "EXCESS_K", (0.0, 3.0, 100.0))
    off = np.where(excess[10:] < 3.0, 0.1, 0.7)  # [K], by hand
    monkeypatch.setattr(ablation, "free_run", lambda predictor, of: of.columns["temp_air_c"][10:] + off)
    one = ablation.by_excess([of(kept, "twin", "extrapolation")], "twin")
    assert one[0].bias_k == pytest.approx((0.1, 0.7))


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
