"""bench/llm_local.py: a model's counts in shares, beside those that need none."""

from collections import Counter
from dataclasses import replace

import pytest

from bench.llm_local import BESIDE, DecidedRun, jobs_of, table
from edge.config.settings import LlmSettings
from training.control.comparison import RunResult
from training.control.figures import Figures

ZERO = Figures(*[0.0] * 16)
MODEL = "Small, 1 M parameters, Q4_1"


def run(entry: str, seed: int, ticks: int, asked: dict[str, int], mae: float, cost: float) -> DecidedRun:
    figures = replace(ZERO, mae_true=mae, sensor_cost_0=cost, sensor_cost_1=2 * cost)
    return DecidedRun(RunResult(entry, "reference_1", seed, figures, MODEL), ticks, Counter(asked), 3)


def cells(lines: list[str], entry: str) -> list[str]:
    (line,) = (line for line in lines if line.split()[:1] == [entry])
    return line.split()


def test_shares_are_of_all_seeds_questions_and_ticks() -> None:
    first = {"answered": 80, "malformed": 20, "in_time": 50, "later": 25, "calls": 10, "sent": 1000}
    second = {"answered": 90, "late": 0, "uncited": 10, "in_time": 100, "received": 3000, "calls_refused": 5}
    runs = [run("LLM-Te0", 1, 100, first, 1.0, 300.0), run("LLM-Te0", 2, 100, second, 2.0, 500.0)]
    found = cells(table(runs, []), "LLM-Te0")
    assert found[1:11] == ["2", "200", "0.85", "0.75", "0.12", "0.12", "0.05", "0.03", "6", "20"]
    assert found[11:13] == ["1.50", "400"]
    assert " ".join(found[13:]) == "malformed 20, uncited 10"


def test_a_row_with_penalty_is_judged_with_it() -> None:
    found = cells(
        table([run("LLM-Te0-P", 1, 10, {"answered": 10, "in_time": 10}, 1.0, 300.0)], []), "LLM-Te0-P"
    )
    assert found[11:] == ["1.00", "600", "none"]


def test_the_rows_beside_are_of_the_same_seeds() -> None:
    kept = [
        RunResult("PID", "reference_1", seed, replace(ZERO, mae_true=float(seed), sensor_cost_0=10.0 * seed))
        for seed in (1, 2, 3)
    ] + [RunResult("PID", "reference_2", 1, replace(ZERO, mae_true=9.0))]
    runs = [run("LLM-Te0", seed, 10, {"answered": 10}, 1.0, 1.0) for seed in (1, 2)]
    assert cells(table(runs, kept), "PID") == ["PID", "2", "1.50", "15"]
    assert "PID" in BESIDE


@pytest.mark.parametrize("seeds", [[1], [1, 2]])
def test_runs_go_seed_by_seed(seeds: list[int]) -> None:
    jobs = jobs_of(["LLM-Te0", "LLM-Te0-P"], seeds, LlmSettings(url="http://there/v1", model=MODEL))
    assert [job.seed for job in jobs] == [seed for seed in seeds for _ in range(2)]
    assert {job.llm.model for job in jobs} == {MODEL}
