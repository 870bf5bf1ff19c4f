"""edge/diagnosis/twin_fit.py and twin_choice.py: values from free runs, and rows that no fit saw."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.prepare import over_rows
from edge.diagnosis.twin_choice import FIRST_ROWS, WHOLE_RUNS, candidates_of, folds_of
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, begun, fit_twins, left_out_errors, together
from edge.diagnosis.unknowns import place_unknowns, unknowns, with_usual
from edge.formats.run_file import cut
from edge.twin.run_batch import batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import BOX, NOISE, STEP_S, Effects, change_run, simulate, twin_file

PLAIN = replace(NOISE, heat_w=0.0, power_share=0.0)  # of sensors alone
TRUTHS: Mapping[str, Effects] = {
    "one mass": BOX,
    "heater lag": {**BOX, "heater_lag": {"tau_h": 200.0}},
    "soil": {**BOX, "soil_mass": {"C_s": 9000.0, "G_s": 6.0}},
    "wall": {"extra_capacity": {"kC": 10.0}, "wall_mass": {"C_w": 6000.0, "G_in": 9.0, "G_out": 7.2}},
}


def runs_of(
    effects: Effects, seeds: Sequence[int] = (1, 2), rows: int = 120, room: bool = True, begin: int = 20
) -> FitRuns:
    """Runs that begin in the middle of another, so many rows after it was switched on."""
    found = [cut(simulate(effects, seed, rows + begin, PLAIN), begin, rows + begin) for seed in seeds]
    batch = batch_runs([run if room else change_run(run, temp_ambient_c=None) for run in found], STEP_S)
    rests = np.full(len(found), begin == 0)
    ambient = over_rows(batch.ambient) if room else np.full_like(batch.duty, 24.0)
    return FitRuns(replace(batch, ambient=ambient), NOISE.sensor_k, rests, np.full(len(rests), not room))


def open_file(effects: Effects, off: float = 1.0) -> TwinFile:
    """A file with all values to be fitted, from starts that are so many times off."""
    return replace(
        twin_file(effects),
        effects={
            name: {key: Value(off * value, fit=True) for key, value in own.items()}
            for name, own in effects.items()
        },
    )


def fitted(effects: Effects, runs: FitRuns, off: float = 1.0) -> FittedTwin:
    return fit_twins([begun(open_file(effects, off))], runs, 20)[0]


@pytest.mark.parametrize("off", [0.4, 2.5])
@pytest.mark.parametrize("name", TRUTHS)
def test_values_of_a_box_are_found_from_runs_that_begin_anywhere(name: str, off: float) -> None:
    effects = TRUTHS[name]
    found = fitted(effects, runs_of(effects), off)
    assert found.rmse_k < 1.1 * NOISE.sensor_k
    for place, value in found.file.values().items():
        if place[0] == "effects":
            assert value.value == pytest.approx(effects[place[1]][place[2]], rel=0.06), place


def test_an_interval_covers_the_truth_and_is_narrow() -> None:
    effects = TRUTHS["heater lag"]
    found = fitted(effects, runs_of(effects))
    sds = np.sqrt(np.diag(found.covariance))
    truth = [item.coordinate(effects[item.place[1]][item.place[2]]) for item in found.free]
    assert np.abs((found.x - truth) / sds).max() < 4.0
    assert sds.max() < 0.05  # logarithms


def test_the_room_of_a_run_is_found_where_no_one_measured_it() -> None:
    found = fitted(BOX, runs_of(BOX, room=False))
    assert found.starts[:, -1] == pytest.approx([21.0, 21.0], abs=1.5)  # by which the room swings


def test_errors_that_go_together_count_once() -> None:
    white = np.random.default_rng(1).standard_normal((12, 4000))
    seen = np.ones(white.shape, dtype=bool)
    assert together(white, seen) == pytest.approx(1.0, abs=0.3)
    assert together(np.repeat(white[:, ::10], 10, axis=1), seen) == pytest.approx(10.0, rel=0.35)
    assert together(0.0 * white, seen) == 1.0


# rows that no fit saw


@pytest.mark.parametrize("count", [1, WHOLE_RUNS - 1, WHOLE_RUNS, 7])
def test_a_row_is_judged_once_at_most_and_never_by_a_fit_that_saw_it_or_later_ones(count: int) -> None:
    folds = folds_of(runs_of(BOX, range(1, count + 1), rows=50))
    masks, judged = (np.stack(column) for column in zip(*folds, strict=True))
    assert not (masks & judged).any()
    assert judged.sum(axis=0).max() == 1
    for mask, rows in folds:
        for fit_row, own in zip(mask, rows, strict=True):
            if own.any():
                assert not fit_row[np.argmax(own) :].any()
    if count >= WHOLE_RUNS:
        assert judged.any(axis=0)[:, FIRST_ROWS:].all()


@pytest.mark.parametrize("again", [0, 4])
@pytest.mark.parametrize("count", [2, 3])
def test_an_error_of_a_left_out_row_does_not_know_its_reading(count: int, again: int) -> None:
    effects = TRUTHS["heater lag"]
    runs = runs_of(effects, range(1, count + 1), rows=80)
    found = fitted(effects, runs)
    fold = folds_of(runs)[-1]
    spoilt = runs.batch.temp.copy()
    spoilt[:, 1:][fold[1]] += 5.0
    spoilt[:, 1:4] = runs.batch.temp[:, 1:4]  # by its first rows a run is begun
    rows = fold[1] & (spoilt != runs.batch.temp)[:, 1:]
    other = replace(runs, batch=replace(runs.batch, temp=spoilt))
    simulated = replace(found.simulated, error=found.simulated.error + np.where(rows, 5.0, 0.0))
    [plain] = left_out_errors([found], [fold], runs, again)
    [moved] = left_out_errors([replace(found, simulated=simulated)], [fold], other, again)
    assert moved[rows] == pytest.approx(plain[rows] + 5.0, abs=1e-6)
    assert np.isnan(plain[~fold[1]]).all()


def test_a_right_twin_misses_a_left_out_run_by_the_noise_though_that_is_heated_from_its_first_row() -> None:
    runs = runs_of(BOX, (1, 2, 3), begin=0)
    (found,) = fit_twins([begun(twin_file())], runs, 1)
    [errors] = left_out_errors([found], folds_of(runs), runs, 4)
    assert float(np.sqrt(np.nanmean(errors**2))) < 1.2 * NOISE.sensor_k


# candidates


@pytest.mark.parametrize(
    ("still", "gone"),
    [
        ("fan_on", {"fan_effectiveness", "short_circuit", "fan_deadtime", "fan_heat"}),
        ("light", {"led_gain"}),
        ("heater_duty", {"heater_lag", "heater_deadtime", "heater_efficiency", "heater_sag"}),
    ],
)
def test_an_effect_whose_input_never_moved_is_no_candidate(still: str, gone: set[str]) -> None:
    run = simulate(BOX, 1, 60)
    plain, held = (
        FitRuns(batch_runs([own], STEP_S), NOISE.sensor_k, np.ones(1, dtype=bool), np.zeros(1, dtype=bool))
        for own in (run, change_run(run, **{still: np.zeros(60)}))
    )
    assert gone <= set(candidates_of(twin_file(), plain))
    assert gone & set(candidates_of(twin_file(), held)) == set()


@pytest.mark.parametrize("answer_s", [None, 1.0, 1e6])
@pytest.mark.parametrize("name", ["soil_mass", "wall_mass", "heater_lag", "infiltration", "imperfect_mixing"])
def test_a_search_never_leaves_what_a_twin_may_have(name: str, answer_s: float | None) -> None:
    file = with_usual(replace(twin_file(), answer_s=answer_s), name)
    free = unknowns(file)
    for end in (0, 1):
        place_unknowns(file, free, np.array([item.bounds[end] for item in free])).twin()
