"""Values that predict, names that stand, and twins worth adopting: judged by rows that no fit saw."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.baselines import arx_errors, arx_weights, simple_twins
from edge.diagnosis.diagnose import Diagnosis, diagnose
from edge.diagnosis.evidence import discover
from edge.diagnosis.free_fit import (
    FIRST_ROWS,
    another,
    apart,
    block_sums,
    fit_values,
    folds,
    free_errors,
    halves,
    left_out_errors,
    together,
)
from edge.diagnosis.handover import JudgedTwin, against_adopting, impossible
from edge.diagnosis.side_by_side import SideBySide
from edge.formats.run_file import RecordedRun, cut
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
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
ROWS = 80


def runs_of(hidden: dict[str, dict[str, float]], count: int = 3) -> RunBatch:
    return batch_runs([simulate({**BOX, **hidden}, seed, ROWS) for seed in range(1, count + 1)], 60.0)


def open_file(start: float = 1.0) -> TwinFile:
    """One mass and a heater that lags, every value to be fitted from a start that is so many times off."""
    effects = {
        "wall_loss": {"UA": Value(4.0 * start, fit=True)},
        "extra_capacity": {"kC": Value(10.0 * start, fit=True)},
        "heater_lag": {"tau_h": Value(200.0 * start, fit=True)},
    }
    return replace(twin_file(), effects=effects)


# folds


def test_every_measured_row_but_the_first_of_a_run_is_left_out_once() -> None:
    runs = runs_of({})
    masks = np.stack(folds(runs))
    assert (masks.sum(axis=0)[:, :FIRST_ROWS] == 0).all()
    assert (masks.sum(axis=0)[:, FIRST_ROWS:] == 1).all()
    assert all(mask[:, -1].all() == (i == len(masks) - 1) for i, mask in enumerate(masks))


def test_what_is_left_out_is_not_measured() -> None:
    runs = runs_of({})
    hidden = folds(runs)[0]
    assert not (replace(runs, left_out=hidden).measured & hidden).any()


def test_halves_share_no_row() -> None:
    half = halves(runs_of({}, count=2))
    assert (half[0] == 0).all()
    assert (half[1] == 1).all()


def test_sums_of_blocks_are_of_all_rows_that_were_left_out() -> None:
    runs = runs_of({})
    sums = block_sums(np.ones(runs.duty.shape), runs)
    assert sums.sum() == np.sum(folds(runs))
    assert sums.min() > 0.5 * sums.max()


# values


def in_a_still_room(run: RecordedRun) -> RecordedRun:
    """The same heater in a box whose room stands still and whose fan never runs."""
    element_w, air_k, temps = 0.0, 0.0, []
    ua_w_k, air_s, element_s = 4.0, 900.0, 200.0
    for duty in run.columns["heater_duty"]:
        temps.append(21.0 + air_k)
        for _ in range(60):
            air_k += (element_w - ua_w_k * air_k) / (ua_w_k * air_s)
            element_w += (100.0 * duty - element_w) / element_s
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(run))
    still = {"temp_air_c": np.array(temps) + noise, "temp_ambient_c": np.full(len(run), 21.0)}
    return replace(run, columns={**run.columns, **still, "fan_on": np.zeros(len(run))})


def test_where_slow_and_fast_may_change_places_other_values_do_as_well() -> None:
    runs = batch_runs([in_a_still_room(simulate(BOX, seed, 200)) for seed in (1, 2)], 60.0)
    [found] = fit_values([open_file()], (), runs, 0.1, SideBySide())
    other = another(found, runs, 0.02, SideBySide())
    assert other is not None
    assert {item.place[2] for item in apart(found, other)} == {"kC", "tau_h"}
    lags = sorted(item.file.values()["effects", "heater_lag", "tau_h"].value for item in (found, other))
    assert lags == pytest.approx([200.0, 900.0], rel=0.1)


def test_where_the_room_tells_them_apart_there_are_no_other_values() -> None:
    runs = runs_of(LAG)
    [found] = fit_values([open_file()], (), runs, 0.1, SideBySide())
    assert another(found, runs, 0.1, SideBySide()) is None


@pytest.mark.parametrize("start", [0.1, 1.0, 10.0])
def test_values_do_not_depend_on_where_a_fit_starts(start: float) -> None:
    runs = runs_of(LAG)
    [found] = fit_values([open_file(start)], (), runs, 0.1, SideBySide())
    values = {
        item.place[2]: item.value(float(x)) for item, x in zip(found.free, found.coordinates, strict=True)
    }
    assert values["tau_h"] == pytest.approx(200.0, rel=0.1)
    assert values["kC"] == pytest.approx(10.0, rel=0.1)
    assert values["UA"] == pytest.approx(4.0, rel=0.1)


def test_an_error_of_a_row_that_is_left_out_does_not_know_its_reading() -> None:
    runs = runs_of(LAG)
    fold = folds(runs)[2]
    fitted = fit_values([open_file()], (), runs, 0.1, SideBySide())
    spoiled = runs.temp.copy()
    spoiled[:, 1:][fold] += 5.0
    [(plain, _)] = left_out_errors(fitted, [fold], runs, SideBySide())
    [(other, _)] = left_out_errors(fitted, [fold], replace(runs, temp=spoiled), SideBySide())
    assert other[fold] == pytest.approx(plain[fold] + 5.0, abs=1e-3)
    assert np.isnan(plain[~fold]).all()


def test_a_free_run_with_the_right_values_misses_by_the_noise() -> None:
    runs = runs_of(LAG)
    [found] = fit_values([open_file()], (), runs, 0.1, SideBySide())
    assert np.sqrt(np.mean(free_errors(found, runs, 0.1) ** 2)) < 0.4


def test_errors_that_go_together_count_once() -> None:
    white = np.random.default_rng(1).standard_normal((2, 4000))
    seen = np.ones(white.shape, dtype=bool)
    assert together(white, seen, TwinFile()) == pytest.approx(1.0, abs=0.3)
    held = np.repeat(white[:, ::10], 10, axis=1)
    assert together(held, seen, TwinFile()) == pytest.approx(10.0, rel=0.35)
    assert together(3.0 * white, seen, TwinFile()) == pytest.approx(9.0, rel=0.3)


# baselines


def test_the_heater_that_lags_is_the_best_of_the_simple_twins_where_it_does() -> None:
    runs = runs_of(LAG)
    twins = simple_twins(twin_file(), runs)
    fitted = fit_values(list(twins.values()), (), runs, 0.1, SideBySide())
    errors = left_out_errors(fitted, folds(runs), runs, SideBySide())
    missed = {name: np.nanmean(own**2) for name, (own, _) in zip(twins, errors, strict=True)}
    assert min(missed, key=lambda name: missed[name]) == "heater lag"


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
    runs = runs_of({}, count=1)
    seen = np.zeros(runs.duty.shape, dtype=bool)
    seen[:, :20] = True
    assert np.isinf(arx_errors(arx_weights(4, runs, seen), runs, seen)).all()


# names


def test_one_strong_name_passes_and_a_weak_one_beside_it_does_not() -> None:
    assert discover({"heater_lag": 50.0, "soil_mass": 2.0}, 24) == {"heater_lag"}
    assert discover({"heater_lag": 5.0}, 24) == set()
    # log(24 / 0.05) is 6.17 for one name, log(24 / 0.10) 5.48 for each of two.
    assert discover({"heater_lag": 5.6, "soil_mass": 5.6}, 24) == {"heater_lag", "soil_mass"}
    assert discover({"heater_lag": 5.6}, 24) == set()


def test_a_mass_that_does_not_fit_into_the_box_is_said() -> None:
    runs = runs_of({})
    # 0.15 m3 of water are 627 kJ/K, and the runs last 79 min.
    file = replace(
        open_file(), effects={"soil_mass": {"C_s": Value(7e5, fit=True), "G_s": Value(3.0, fit=True)}}
    )
    [found] = fit_values([file], (), runs, 0.1, SideBySide())
    placed = replace(
        found,
        file=file,
        coordinates=np.array([item.coordinate(v) for item, v in zip(found.free, (7e5, 3.0), strict=True)]),
    )
    heavy, slow = impossible("soil_mass", placed, runs, 60.0)
    assert heavy == "C_s would store 1.1 times the heat of the box full of water"
    assert slow.startswith("a time constant of 65 h can't be seen in 1.3 h")


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
    judged = found.judgement
    assert [effect.name for effect in judged.verdict.effects] == ["heater_lag"]
    assert judged.standings["heater_lag"].against == ()
    assert judged.standings["heater_lag"].probability > 0.9
    assert judged.handover.rmse_k < 0.3 * judged.comparison.trials[frozenset()].rmse_k
    assert found.is_offered


def test_a_twin_is_not_offered_where_it_predicts_no_better(found: Diagnosis) -> None:
    handed, given = found.judgement.handover, found.judgement.comparison.trials[frozenset()]
    simple = {"one mass": 9.0}
    assert against_adopting(given, handed, simple, {}) == ()
    [worse] = against_adopting(handed, given, simple, {})
    assert "those of the twin as given" in worse
    [tested] = against_adopting(given, handed, simple, {"before": 0.5, "after": 0.6, "one mass": 0.7})
    assert tested == "over the test runs its free runs miss by 0.6 K, before by 0.5 K"
    [simpler] = against_adopting(given, handed, {"one mass": 0.0}, {})
    assert simpler.startswith("over left-out rows a single mass misses by 0 K")


def test_a_value_at_its_bound_is_not_offered(found: Diagnosis) -> None:
    handed = found.judgement.handover
    at_end = np.array([item.bounds[1] for item in handed.fit.free])
    stuck = JudgedTwin(handed.added, replace(handed.fit, coordinates=at_end), handed.errors)
    given = found.judgement.comparison.trials[frozenset()]
    [said] = against_adopting(given, stuck, {"one mass": 9.0}, {})
    assert said.startswith("a value is as far as it can go: ")
    assert "effects.heater_lag.tau_h" in said


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
