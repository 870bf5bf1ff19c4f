"""Simple models that a twin has to beat, and twins worth adopting: judged by rows that no fit saw."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.baselines import arx_errors, arx_weights
from edge.diagnosis.diagnose import Diagnosis, _against, diagnose
from edge.formats.run_file import RecordedRun, cut
from edge.twin.run_batch import RunBatch, batch_runs
from tests.support.simulated_runs import (
    BOX,
    as_diagnosis_runs,
    candidates_only,
    change_run,
    silent,
    simulate,
    twin_file,
)

pytestmark = pytest.mark.slow

LAG = {"heater_lag": {"tau_h": 200.0}}


def test_an_arx_forecasts_its_own_kind() -> None:
    draw = np.random.default_rng(1)
    rows = 400
    duty, temp = np.repeat(draw.choice([0.0, 1.0], rows // 20), 20), np.full(rows + 1, 25.0)
    for k in range(1, rows):
        temp[k + 1] = 1.5 * temp[k] - 0.54 * temp[k - 1] + 0.3 * duty[k] + 0.1 * duty[k - 1] + 0.04 * 20.0
    fan, room = np.zeros((1, rows)), np.full((1, rows), 20.0)
    runs = RunBatch(temp[None], duty[None], fan, room)
    seen = np.ones((1, rows), dtype=bool)
    seen[:, 200:] = False
    assert np.abs(arx_errors(arx_weights(2, runs, seen), runs, seen)).max() < 1e-6


def test_an_arx_of_too_few_rows_is_no_baseline() -> None:
    runs = batch_runs([simulate(BOX, 1, 80)], 60.0)
    seen = np.zeros(runs.duty.shape, dtype=bool)
    seen[:, :20] = True
    assert np.isinf(arx_errors(arx_weights(4, runs, seen), runs, seen)).all()


# the whole


def recordings() -> list[RecordedRun]:
    return [simulate({**BOX, **LAG}, seed, 60) for seed in (1, 2, 3)]


def answer(runs: Sequence[RecordedRun]) -> Diagnosis:
    with candidates_only("heater_lag", "sensor_lag", "infiltration"):
        return diagnose(twin_file(), as_diagnosis_runs(runs), silent, "")


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return answer(recordings())


def test_what_is_there_stands_and_predicts_rows_that_no_fit_saw(found: Diagnosis) -> None:
    [effect] = found.verdict.effects
    assert effect.name == "heater_lag"
    assert effect.probability > 0.9
    assert effect.alternatives == {}
    assert found.verdict.doubtful == ()
    assert found.verdict.handed.left_out_k < 0.3 * found.choice.tried[frozenset()].left_out_k
    assert found.is_offered


def test_the_heater_that_lags_is_the_best_of_the_simple_twins_where_it_does(found: Diagnosis) -> None:
    missed = found.baselines.left_out_k
    assert min(missed, key=lambda name: missed[name]) == "heater lag"


def test_a_twin_is_not_offered_where_it_predicts_no_better(found: Diagnosis) -> None:
    given = found.choice.tried[frozenset()]
    verdict = replace(found.verdict, handed=given)
    worse, simpler, *_ = _against(replace(found, verdict=verdict))
    assert "those of the twin as given" in worse
    assert simpler.startswith("over left-out rows heater lag misses by")
    missed = found.baselines.left_out_k
    tested = replace(found.baselines, left_out_k={**missed, "one mass": 0.0})
    [better] = _against(replace(found, baselines=tested))
    assert better.startswith("over left-out rows one mass misses by 0 K")
    own_k = found.verdict.handed.left_out_k
    for share, is_said in ((0.9, False), (0.7, True)):  # an ARX is no twin: a little better is no reason
        tested = replace(found.baselines, left_out_k={**missed, "ARX 2": share * own_k})
        assert any("run MPC-P" in line for line in _against(replace(found, baselines=tested))) == is_said


def test_order_date_and_files_of_the_runs_change_no_answer(found: Diagnosis) -> None:
    later = [change_run(run, {"start_utc": "2027-07-01T08:00:00Z"}) for run in recordings()]
    parts = [cut(later[0], 0, 30), cut(later[0], 30, 60)]
    halves = [replace(part, path=later[0].path.with_suffix(f".{i}")) for i, part in enumerate(parts)]
    other = answer([later[2], *halves, later[1]])
    [effect], [again] = found.verdict.effects, other.verdict.effects
    assert effect.name == again.name == "heater_lag"
    value = effect.parameters["tau_h"]
    assert value.low is not None
    assert value.high is not None
    assert value.low <= again.parameters["tau_h"].value <= value.high
