"""Figures of a run by hand, and the tables of a comparison from a handful of made-up results."""

import argparse
import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import requests

from edge.core.errors import DataError
from training.control import compare
from training.control.closed_loop import ClosedLoopLog
from training.control.compare import (
    OURS,
    _endpoint,
    at_most,
    energy_picture,
    energy_table,
    energy_tables,
    kept_section,
    pictures_of,
    run,
    section,
    text_of,
)
from training.control.comparison import (
    FIGURES_FILE,
    TIMES_FILE,
    RunResult,
    beside,
    column,
    first_change,
    json_of,
    knowledge,
    parts_table,
    ranking,
    read_results,
    read_times,
    regret,
    results_of,
    times_beside,
    times_json,
)
from training.control.figures import (
    DecisionTime,
    Figures,
    Mean,
    before_k,
    cycles,
    figures,
    left_k,
    mean_of,
    overshoot_k,
    ratio,
)
from training.control.rig import entries
from training.llm_stand_in import MODEL as STAND_IN

ZERO = Figures(*[0.0] * 16)


def made(entry: str, seed: int, model: str = "", **figures: float) -> RunResult:
    return RunResult(entry, "reference_1", seed, replace(ZERO, **figures), model)


RESULTS = [
    made("clairvoyant/sensor", 1, sensor_cost_0=100.0),
    made("clairvoyant/sensor", 2, sensor_cost_0=200.0),
    made("MPC-Twin", 1, sensor_cost_0=110.0, mae_true=0.2),
    made("MPC-Twin", 2, sensor_cost_0=220.0, mae_true=0.2),
    made("MPC-BFGS", 1, sensor_cost_0=900.0, mae_true=1.2),
    made("MPC-BFGS", 2, sensor_cost_0=800.0, mae_true=1.2),
    made("MPC-BFGS", 3, sensor_cost_0=700.0, mae_true=1.2),
    made("LLM-Te0", 1, STAND_IN, mae_true=1.4, sensor_cost_0=990.0),
    made("LLM-Te0", 2, STAND_IN, mae_true=1.4, sensor_cost_0=990.0),
]


def test_a_regret_is_the_cost_by_the_limits_on_the_same_seeds():
    assert regret(RESULTS, "MPC-Twin", "reference_1", by_sensor=True).value == pytest.approx(1.1)
    assert regret(RESULTS, "MPC-BFGS", "reference_1", by_sensor=True).n == 2
    assert regret(RESULTS, "MPC-Twin", "reference_2", by_sensor=True) is None


@pytest.mark.parametrize("better", ["clairvoyant/sensor-P", "MPC-Twin-P"])
def test_no_run_is_better_than_the_limit(better):
    found = [*RESULTS, made(better, 1, sensor_cost_0=80.0)]
    assert regret(found, "MPC-Twin", "reference_1", by_sensor=True).value == pytest.approx(
        (110 / 80 + 1.1) / 2
    )
    own = regret(found, "clairvoyant/sensor", "reference_1", by_sensor=True)
    assert own.value == pytest.approx((100 / 80 + 1.0) / 2)


def test_a_controller_is_ranked_among_those_that_know_as_much():
    costs = {
        "MPC": 300.0,
        "MPC/preview": 250.0,
        "MPC-Twin": 120.0,
        "MPC-Twin/present": 280.0,
        "MPC-BFGS": 260.0,
        "MPC-BFGS/preview": 200.0,
        "clairvoyant/sensor": 100.0,
    }
    found = [made(name, 1, sensor_cost_0=cost) for name, cost in costs.items()]
    assert ranking(found, list(costs), "reference_1") == [
        *("clairvoyant/sensor", "MPC-BFGS/preview", "MPC/preview", "MPC-Twin"),
        *("MPC-BFGS", "MPC-Twin/present", "MPC"),
    ]
    assert [knowledge(name) for name in ("clairvoyant", "MPC-Twin/early", "MPC", "RL-Off")] == [
        *("everything", "coming reference", "present reference", "present reference")
    ]


def test_a_limit_among_equals_leaves_out_the_runs_that_do_more_with_the_coming_reference():
    costs = {
        "clairvoyant/sensor": 50.0,
        "MPC-Twin/early": 60.0,
        "clairvoyant/sensor/band": 80.0,
        "MPC-Twin": 100.0,
        "clairvoyant/sensor/present": 160.0,
        "MPC-Twin/present": 200.0,
    }
    found = [made(name, 1, sensor_cost_0=cost) for name, cost in costs.items()]
    limits = {name: regret(found, name, "reference_1", True, among_equals=True).value for name in costs}
    assert limits == pytest.approx(
        {
            "clairvoyant/sensor": 1.0,
            "MPC-Twin/early": 1.2,
            "clairvoyant/sensor/band": 1.0,
            "MPC-Twin": 1.25,
            "clairvoyant/sensor/present": 1.0,
            "MPC-Twin/present": 1.25,
        }
    )


SMALL, LARGE = "Small, 1 M parameters, Q4_1", "Large-P, 9 M parameters, Q8_0"
MODELS = [
    *RESULTS,
    made("LLM-Te0", 1, SMALL, mae_true=1.1, sensor_cost_0=500.0),
    made("LLM-Te0", 1, LARGE, mae_true=0.9, sensor_cost_0=400.0),
]


def test_each_language_model_has_a_row_that_names_it_and_a_script_has_none():
    text = text_of(MODELS, ["clairvoyant/sensor", "MPC-Twin", "LLM-Te0"])
    ranked, scripted = text.split(f"reference_1: {STAND_IN}")
    rows = [line.split("  ")[0] for line in ranked.splitlines() if line.startswith("LLM")]
    assert rows == [f"LLM-Te0 by {LARGE}", f"LLM-Te0 by {SMALL}"]
    assert [line.split("  ")[0] for line in scripted.splitlines() if line.startswith("LLM")] == [
        f"LLM-Te0 by {STAND_IN}"
    ]
    assert "MPC-Twin" not in scripted


def test_a_models_name_says_nothing_of_its_rows_weight_and_knowledge():
    row = f"LLM-Te0 by {LARGE}"
    assert regret(MODELS, row, "reference_1", by_sensor=True).value == pytest.approx(4.0)
    assert knowledge(row) == "present reference"


def test_a_models_run_is_kept_beside_another_models():
    now = [made("LLM-Te0", 1, SMALL, mae_true=2.0)]
    both = beside(MODELS, now, ["LLM-Te0"])
    found = {one.model: one.figures.mae_true for one in both if one.seed == 1}
    assert found == {STAND_IN: 1.4, SMALL: 2.0, LARGE: 0.9}


def test_figures_come_back_with_all_their_digits():
    assert results_of(json_of(RESULTS)) == RESULTS
    assert "MPC-Twin" in text_of(RESULTS, ["MPC-Twin"])


def test_an_unknown_controller_is_refused_by_name(tmp_path):
    arguments = argparse.Namespace(
        controllers=["MPC-Twn"], references=["reference_1"], seeds=[1], runs=tmp_path, kept=True,
        llm_url="", llm_model="stand-in", llm_exchanges=8, llm_answer_tokens=800,
    )  # fmt: skip
    with pytest.raises(DataError, match="MPC-Twn"):
        run(arguments)


@pytest.mark.parametrize("wants", ["check", "beside_kept"])
def test_figures_that_are_not_there_are_told_before_anything_is_run(tmp_path, monkeypatch, wants):
    monkeypatch.setattr(compare, "run_all", lambda *words: pytest.fail("it was run"))
    flags = {"check": False, "beside_kept": False, "kept": False} | {wants: True}
    arguments = argparse.Namespace(
        controllers=["rules"], references=["reference_1"], seeds=[1], runs=tmp_path, results=tmp_path,
        workers=1, llm_url="", llm_model="stand-in", **flags,
    )  # fmt: skip
    with pytest.raises(DataError, match=FIGURES_FILE):
        run(arguments)


def endpoint(**given: object) -> argparse.Namespace:
    usual = {"kept": False, "llm_url": "", "llm_model": "stand-in"}
    return argparse.Namespace(**(usual | {"llm_exchanges": 4, "llm_answer_tokens": 300} | given))


def test_language_models_ask_a_stand_in_where_no_server_is_given():
    with _endpoint(endpoint()) as llm:
        assert requests.get(f"{llm.url}/models", timeout=5.0).status_code == 200
    assert llm.model == "stand-in"
    with _endpoint(endpoint(llm_url="http://there/v1", llm_model="small")) as llm:
        assert (llm.url, llm.model, llm.exchanges, llm.answer_tokens) == ("http://there/v1", "small", 4, 300)


def test_a_model_without_its_server_is_refused():
    with pytest.raises(DataError, match="small needs --llm-url"), _endpoint(endpoint(llm_model="small")):
        pass


def test_the_controllers_part_is_made_from_the_saved_figures_and_pictures(tmp_path: Path):
    assert kept_section(tmp_path, tmp_path) == ""
    kept_in(tmp_path, RESULTS, {})
    (tmp_path / "control_mae.png").write_bytes(b"a picture")
    made = kept_section(tmp_path, tmp_path)
    assert made.startswith("<h1>Controllers on the virtual rig, compared</h1>")
    assert 'alt="control_mae"' in made


def test_a_few_controllers_have_pictures(tmp_path: Path):
    few = [made("MPC/HAM", 1, mae_true=0.3)]
    assert set(pictures_of(few, [], tmp_path, ["MPC/HAM"])) == {"control_mae", "control_energy"}


def test_the_findings_that_a_person_has_written_stand_in_the_controllers_part() -> None:
    made = section(RESULTS, ["MPC-Twin"], {}, "# Ours\n\n**Said.** *Holds.* a < b\n")
    assert "<h2>Ours</h2>\n<p><b>Said.</b> <em>Holds.</em> a &lt; b</p>\n" in made


def kept_in(folder: Path, results: list[RunResult], times: dict[str, list[DecisionTime]]) -> Path:
    (folder / FIGURES_FILE).write_text(json_of(results))
    (folder / TIMES_FILE).write_text(times_json(times))
    return folder


def test_a_controller_done_anew_leaves_the_others_as_they_are_kept():
    now = [made("MPC-Twin", 2, mae_true=0.1), made("LLM-Te0", 3, STAND_IN, mae_true=1.0, sensor_cost_0=990.0)]
    names = ["clairvoyant/sensor", "MPC-BFGS", "MPC-Twin", "LLM-Te0"]
    both = beside(RESULTS, now, names)
    assert len(both) == len(RESULTS) + 1
    assert column(both, "MPC-Twin", "reference_1", "mae_true") == [0.2, 0.1]
    assert column(both, f"LLM-Te0 by {STAND_IN}", "reference_1", "mae_true") == [1.4, 1.4, 1.0]
    assert [one.entry for one in both[:4]] == names  # seed by seed, as they would be done


def test_what_has_left_the_table_is_not_kept_beside():
    assert {one.entry for one in beside(RESULTS, [], ["MPC-Twin"])} == {"MPC-Twin"}


def test_decision_times_are_of_all_runs_or_as_they_are_kept():
    kept = {"MPC": [DecisionTime(1.0, 2.0)] * 2, "PID": [DecisionTime(3.0, 4.0)]}
    now = {
        "MPC": [DecisionTime(9.0, 9.0)],
        "PID": [DecisionTime(5.0, 6.0)],
        "rules": [DecisionTime(0.1, 0.2)],
    }
    both = times_beside(kept, now, ["rules", "PID", "MPC"])
    assert both == {"rules": now["rules"], "PID": now["PID"], "MPC": kept["MPC"]}
    assert list(both) == ["rules", "PID", "MPC"]


def test_decision_times_come_back(tmp_path):
    times = {"MPC": [DecisionTime(1.25, 2.5)]}
    assert read_times(kept_in(tmp_path, RESULTS, times)) == times


@pytest.mark.parametrize("text", ["", "{", "[]", '{"MPC": [{"median": 1}]}', '{"MPC": 3}'])
def test_broken_decision_times_are_refused_by_file(tmp_path, text):
    (tmp_path / TIMES_FILE).write_text(text)
    with pytest.raises(DataError, match=TIMES_FILE):
        read_times(tmp_path)


@pytest.mark.parametrize("text", [None, "", "[", "[1]", '[{"entry": "MPC"}]', '{"a": 1}'])
def test_broken_figures_are_refused_by_file(tmp_path, text):
    if text is not None:
        (tmp_path / FIGURES_FILE).write_text(text)
    with pytest.raises(DataError, match=FIGURES_FILE):
        read_results(tmp_path)


def test_a_few_runs_are_checked_against_theirs_alone():
    assert first_change(RESULTS, RESULTS[3:5]) == ""
    other = [made("MPC-Twin", 2, sensor_cost_0=220.0, mae_true=0.2000001)]
    assert first_change(RESULTS, other).startswith(
        "MPC-Twin, reference_1, seed 2.figures.mae_true: 0.2 is kept"
    )
    assert first_change(RESULTS, other, tolerance=1e-6) == ""
    assert "mae_true" in first_change(
        RESULTS, [made("MPC-Twin", 2, sensor_cost_0=220.0, mae_true=0.202)], 0.005
    )
    assert "seed 7: no such run is kept" in first_change(RESULTS, [made("MPC-Twin", 7)])


def test_ours_stands_beside_the_best_plan_with_a_fan_of_whole_steps():
    names = ["MPC-Twin-P", "clairvoyant/sensor-P/band/whole"]
    costs = dict(zip(names, (80.0, 100.0), strict=True))
    found = [made(name, seed, sensor_cost_1=cost) for seed in (1, 2) for name, cost in costs.items()]
    shown = parts_table([*found, made("MPC-Twin-P", 3, sensor_cost_1=500.0)], names, "reference_1")
    assert shown is not None and shown.rows == ((*names, "2", "0.80", ""),)
    assert parts_table(RESULTS, list(entries()), "reference_1") is None


def test_a_figure_that_was_not_measured_then_is_no_change():
    now = [made("MPC-Twin", 1, sensor_cost_0=110.0, mae_true=0.2, before_k=0.3, cycles=2.0)]
    assert first_change(RESULTS, now) == ""
    other = [replace(now[0], figures=replace(now[0].figures, before_k=0.4))]
    assert "before_k" in first_change(now, other)


def test_json_is_json():
    assert len(json.loads(json_of(RESULTS))) == len(RESULTS)


CURVE = np.array([110.0, 100.0, 80.0, 60.0, 50.0, 40.0]), np.array([0.3, 0.2, 1.0, 2.0, 2.5, 3.0])  # Wh, K


def with_energy(entry: str, seed: int, energy: float, mae: float) -> RunResult:
    return RunResult(entry, "reference_1", seed, replace(ZERO, energy_wh=energy, mae_true=mae))


def ours(seed: int) -> list[RunResult]:
    return [with_energy(name, seed, *point) for name, *point in zip(OURS, *CURVE, strict=True)]


@pytest.mark.parametrize(
    ("limit", "expected"), [(40.0, 3.0), (50.0, 2.5), (100.0, 0.2), (105.0, 0.2), (110.0, 0.2), (500.0, 0.2)]
)
def test_the_curve_gives_the_best_with_no_more_energy(limit, expected):
    assert at_most(limit, *CURVE) == pytest.approx(expected)


def test_the_curve_gives_the_least_energy_for_a_mae():
    energy, mae = CURVE
    assert at_most(1.5, mae, energy) == pytest.approx(70.0)
    assert at_most(9.0, mae, energy) == 40.0


@pytest.mark.parametrize("limit", [39.9, -1.0, float("nan")])
def test_below_the_curve_is_nothing(limit):
    assert np.isnan(at_most(limit, *CURVE))


def test_a_controller_stands_beside_ours_seed_by_seed():
    results = [*ours(1), *ours(2), *(with_energy("RL-Off", seed, 90.0, 1.5) for seed in (1, 2, 3))]
    table = energy_table(results, ["RL-Off", "clairvoyant"], "reference_1")
    assert table.rows == (("RL-Off", "90", "1.500", "0.600", "0.900", "70", "20"),)


def test_a_mae_is_by_the_true_air_and_by_the_sensor():
    def by_sensor(one):
        return replace(one, figures=replace(one.figures, mae_measured=one.figures.mae_true / 2.0))

    results = [by_sensor(one) for one in (*ours(1), with_energy("RL-Off", 1, 90.0, 1.5))]
    true, sensor = energy_tables(results, ["RL-Off"], "reference_1")
    assert true.rows == (("RL-Off", "90", "1.500", "0.600", "0.900", "70", "20"),)
    assert sensor.rows == (("RL-Off", "90", "0.750", "0.300", "0.450", "70", "20"),)
    assert (true.title != sensor.title, energy_tables([], ["RL-Off"], "reference_1")) == (True, [])


def test_less_than_ours_can_is_a_dash():
    table = energy_table([*ours(1), with_energy("PID", 1, 30.0, 0.1)], ["PID"], "reference_1")
    assert table.rows == (("PID", "30", "0.100", "-", "-", "-", "-"),)


def test_without_ours_at_every_weight_there_is_no_table():
    assert energy_table([*ours(1)[1:], with_energy("PID", 1, 30.0, 0.1)], ["PID"], "reference_1") is None
    assert energy_picture([with_energy("PID", 1, 30.0, 0.1)], ["PID"], ["reference_1"]).startswith(b"\x89PNG")


def log(**columns: list[float]) -> ClosedLoopLog:
    """Four ticks, a minute apart: the air is 1 K below, 0.5 K above, right."""
    rows = {
        "time_s": [0.0, 60.0, 120.0, 180.0],
        "reference_c": [25.0, 25.0, 25.0, 25.0],
        "true_air_c": [21.0, 24.0, 25.5, 25.0],
        "temp_air_c": [21.4, 24.4, np.nan, 25.4],
        "sensor_air_c": [21.0, 24.0, 25.0, 24.6],
        "heater_duty": [1.0, 0.5, 0.0, 1.0],
        "fan_on": [0.0, 1.0, 0.0, 0.0],
        "solve_ms": [1.0, 2.0, 3.0, 4.0],
    } | columns
    counted = Counter({"fan.min_on": 2}), Counter({"controller.late": 1})
    return ClosedLoopLog(
        {key: np.array(values) for key, values in rows.items()}, *counted, 0, asked=Counter(sent=7)
    )


def test_errors_are_of_the_end_of_each_step():
    found = figures(log())
    assert found.mae_true == pytest.approx((1.0 + 0.5 + 0.0) / 3)
    assert found.rmse_true == pytest.approx(np.sqrt((1.0 + 0.25) / 3))
    assert found.mae_measured == pytest.approx((0.6 + 0.4) / 2)  # a missing reading is no error
    assert found.near_pct == pytest.approx(100.0 * 2 / 3)  # half a kelvin is still near


def test_a_command_counts_until_the_next_one():
    found = figures(log())
    assert found.energy_wh == pytest.approx(1.5 * 100.0 / 60.0)  # the last row's never acted
    assert found.fan_min == pytest.approx(1.0)
    assert found.switches == 2.0
    assert found.travel == pytest.approx(0.5 + 0.5 + 1.0)


def test_the_cost_is_the_papers():
    found = figures(log())
    assert found.cost_0 == pytest.approx(10.0 * (1.0 + 0.25))
    assert found.cost_1 == pytest.approx(found.cost_0 + 1.0 + 0.25 + 1.0)  # duty² and the fan
    assert found.sensor_cost_0 == pytest.approx(10.0 * (0.6**2 + 0.4**2))  # 0.4 K of bias is the sensor's


def test_what_was_counted_comes_through():
    found = figures(log())
    assert (found.interventions, found.fallbacks, found.tokens) == (2.0, 1.0, 7.0)


@pytest.mark.parametrize(
    ("air", "beyond"),
    [
        ([20.0, 20.0, 23.0, 22.5], 1.0),  # 22 asked for from row 1 on
        ([20.0, 20.0, 21.0, 21.9], 0.0),
        ([20.0, 23.0, 22.0, 22.0], 0.0),  # what was before the step is not its overshoot
    ],
)
def test_overshoot_is_what_lies_beyond_the_new_reference(air, beyond):
    assert overshoot_k(np.array([20.0, 22.0, 22.0, 22.0]), np.array(air)) == pytest.approx(beyond)


def test_overshoot_after_a_step_down_lies_below():
    reference, air = np.array([24.0, 22.0, 22.0]), np.array([24.0, 24.0, 20.5])
    assert overshoot_k(reference, air) == pytest.approx(1.5)


def test_the_air_is_early_as_far_as_it_left_the_reference_towards_a_coming_step():
    reference = np.repeat([20.0, 25.0, 22.0], 20)
    error = np.zeros(59)
    error[15:20] = [0.1, -0.2, 0.2, 0.5, 0.3]  # 25 is due after these
    assert before_k(reference, error) == pytest.approx(0.5)
    error[36:40] = [3.0, 2.0, 1.0, 0.0]  # on its way back, and not towards 22
    assert before_k(reference, error) == pytest.approx(0.5)
    error[39] = -0.8
    assert before_k(reference, error) == pytest.approx(0.8)


def test_a_fan_that_starts_again_soon_after_heat_is_a_cycle():
    fan = np.zeros(40)
    fan[[0, 5, 20, 21]] = [0.5, 1.0, 0.25, 0.25]
    still, stepped = np.full(40, 25.0), np.where(np.arange(40) < 24, 25.0, 28.0)
    assert cycles(np.full(40, 0.4), fan, still) == 0
    assert cycles(np.ones(40), fan, still) == 2  # 15 steps between the second and the third
    assert cycles(np.ones(40), fan, stepped) == 1  # the step asks for the last


def test_only_air_that_goes_away_from_the_reference_has_left_it():
    assert left_k(np.array([2.0, 1.5, 1.0, 0.5])) == 0.0  # on its way back
    assert left_k(np.array([-1.0, -0.2, 0.3])) == pytest.approx(0.3)
    assert left_k(np.array([1.0, 0.2, 0.1, 0.7])) == pytest.approx(0.6)


def test_a_ramp_is_no_step():
    assert overshoot_k(np.array([20.0, 20.5, 21.0]), np.array([20.0, 25.0, 25.0])) == 0.0


def test_the_interval_is_students():
    found = mean_of([1.0, 2.0, 3.0])
    assert found.value == 2.0
    assert found.half == pytest.approx(4.3027 / math.sqrt(3.0), rel=1e-4)  # t(2, 0.975), sd 1


def test_one_seed_says_nothing_of_the_spread():
    assert mean_of([1.0]) == Mean(1.0, math.inf, 1)


def test_no_seed_is_an_error():
    with pytest.raises(ValueError, match="no values"):
        mean_of([])


def test_seeds_are_paired():
    assert ratio([1.0, 3.0], [0.5, 1.5]) == Mean(2.0, 0.0, 2)
