"""edge/diagnosis/gap.py: free runs from where a run begins or is known to, and what they miss."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.gap import FIRST_ROWS, RunForecast, errors, forecasts, known_errors, predict
from edge.diagnosis.prepare import PreparedRuns, prepare
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.twin_fit import FittedTwin, begun, fit_twins
from edge.formats.run_file import RecordedRun, cut, resample
from edge.twin.model import BoxTwin
from tests.support.simulated_runs import (
    BOX,
    QUIET,
    Effects,
    Floats,
    as_diagnosis_runs,
    change_run,
    simulate,
    twin_file,
)

SLOW: Effects = {
    "extra_capacity": {"kC": 10.0},
    "wall_mass": {"C_w": 6000.0, "G_in": 9.0, "G_out": 7.2},
    "heater_lag": {"tau_h": 200.0},
    "heater_deadtime": {"d_h": 75.0},
}
BOXES = pytest.mark.parametrize("effects", [BOX, SLOW], ids=["one state", "walls, a slow and late heater"])
ROWS = 80


def named(run: RecordedRun) -> NamedRun:
    return NamedRun(str(run.path), run, run.columns["time_s"])


def missed(run: RecordedRun, effects: Effects = BOX, room_k: float = 0.0) -> Floats:
    """Errors of a known twin's prediction from the first rows on, the room as recorded or warmer."""
    room_c = run.columns["temp_ambient_c"] + room_k
    return run.columns["temp_air_c"] - predict(twin_file(effects, QUIET), named(run), room_c)


def measured_only(run: RecordedRun, rows: object) -> RecordedRun:
    """The run with temperatures in these rows alone."""
    temp = np.full(len(run), np.nan)
    temp[rows] = run.columns["temp_air_c"][rows]
    return change_run(run, temp_air_c=temp)


def from_the_middle(run: RecordedRun, first: int = 25) -> RecordedRun:
    """The rest of a run, which begins at no rest."""
    later = cut(run, first, len(run))
    return replace(later, path=run.path)


@pytest.fixture(scope="module")
def known() -> tuple[PreparedRuns, FittedTwin]:
    """A run to fit, and a twin that is known exactly."""
    prepared = prepare(twin_file(), as_diagnosis_runs([simulate(BOX, 3, ROWS)]))
    return prepared, fit_twins([begun(prepared.file)], prepared.fit_runs, 1)[0]


@BOXES
def test_the_twin_that_made_a_run_reproduces_it(effects: Effects) -> None:
    assert np.abs(missed(simulate(effects, 1, ROWS, QUIET), effects)).max() < 0.05


@BOXES
def test_a_run_that_begins_warm_begins_as_its_first_rows_have_it(effects: Effects) -> None:
    off = missed(from_the_middle(simulate(effects, 1, 150, QUIET)), effects)
    assert np.abs(off[1:]).max() < 0.05


def test_temperatures_behind_the_first_rows_are_not_used(known: tuple[PreparedRuns, FittedTwin]) -> None:
    prepared, fit = known
    run = from_the_middle(simulate(BOX, 1, 150))
    blind = measured_only(run, slice(FIRST_ROWS + 1))
    seen, unseen = forecasts(fit, [replace(named(item), name="t.csv") for item in (run, blind)], prepared)
    assert seen.predicted == pytest.approx(unseen.predicted, abs=0.0)
    assert np.isnan(unseen.residual).all()


def test_a_run_without_a_fan_column_has_a_fan_that_stands_still() -> None:
    run = simulate(BOX, 1, ROWS, fan=False)
    assert missed(change_run(run, fan_on=None)) == pytest.approx(missed(run), abs=0.0)


def test_the_room_that_is_given_is_the_one_that_counts() -> None:
    run = simulate(BOX, 1, ROWS, QUIET)
    later = (missed(run) - missed(run, room_k=3.0))[-1]  # by many time constants
    assert later == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    ("from_row", "holes", "start"), [(40, (), 39), (40, (39, 38), 37), (None, (), FIRST_ROWS)]
)
def test_a_test_run_is_judged_behind_what_is_known_of_it(
    known: tuple[PreparedRuns, FittedTwin], from_row: int | None, holes: tuple[int, ...], start: int
) -> None:
    prepared, fit = known
    run = from_the_middle(simulate(BOX, 1, ROWS + 25))
    run = measured_only(run, [k for k in range(ROWS) if k not in holes])
    from_s = None if from_row is None else 60.0 * from_row
    (found,) = forecasts(fit, [replace(named(run), name="test.csv", from_s=from_s)], prepared)
    assert found.start == start
    assert len(found.residual) == ROWS - 1 - start
    assert float(np.sqrt(np.nanmean(found.residual**2))) < 0.5
    assert len(found.predicted) == ROWS


def test_a_run_at_rest_is_judged_from_its_first_row(known: tuple[PreparedRuns, FittedTwin]) -> None:
    prepared, fit = known
    run = simulate(BOX, 1, ROWS)
    duty, fan, room = np.repeat([0.0, 0.5], ROWS // 2), np.zeros(ROWS), np.full(ROWS, 21.0)
    temp = BoxTwin(effects=BOX).rollout(room[:1], duty[None, :-1], fan[None, :-1], room[:-1])[0]
    columns = {"heater_duty": duty, "fan_on": fan, "temp_ambient_c": room}
    rest = change_run(run, temp_air_c=np.append(room[0], temp), **columns)
    (found,) = forecasts(fit, [replace(named(rest), name="test.csv")], prepared)
    assert found.start == 0
    assert np.abs(found.residual).max() < 0.05


# errors


def made(residual: object, start: int = 0, name: str = "a.csv") -> RunForecast:
    values = np.asarray(residual, float)
    flat = np.full(len(values), 20.0)
    return RunForecast(name, start, flat + values, flat, flat)


def test_errors_are_of_the_rows_behind_the_start_that_were_measured() -> None:
    # Of 3, -1, NaN behind the start: root of (9 + 1) / 2, mean of 3 and 1.
    found = errors([made([9.0, 3.0, -1.0, np.nan])])
    assert found == {
        "rmse_k": pytest.approx(5.0**0.5),
        "mae_k": pytest.approx(2.0),
        "per_run": {"a.csv": {"rmse_k": pytest.approx(5.0**0.5), "mae_k": pytest.approx(2.0)}},
    }


def test_together_each_row_counts_once_not_each_run() -> None:
    found = errors([made([0.0, 2.0]), made([0.0, 1.0, 1.0, 1.0, 1.0, 1.0], name="b.csv")])
    assert found is not None
    assert found["rmse_k"] == pytest.approx((9.0 / 6.0) ** 0.5)  # 4 and five times 1, over 6 rows
    assert set(found["per_run"]) == {"a.csv", "b.csv"}


def test_a_run_with_nothing_to_compare_with_is_left_out() -> None:
    found = errors([made([0.0, np.nan, np.nan]), made([0.0, 1.0], name="b.csv")])
    assert found is not None
    assert list(found["per_run"]) == ["b.csv"]
    for nothing in ([made([0.0, np.nan])], [made([0.0])], []):
        assert errors(nothing) is None
    with pytest.raises(DataError, match="no measured row to compare a free run with"):
        known_errors([made([0.0])])


def test_between_the_rows_of_a_coarser_recording_nothing_is_missed(
    known: tuple[PreparedRuns, FittedTwin],
) -> None:
    prepared, fit = known
    fine = simulate(BOX, 1, ROWS, QUIET)
    coarse = replace(fine, columns={name: column[::5] for name, column in fine.columns.items()})
    spread = resample(coarse, 60.0)
    item = NamedRun("coarse", spread, coarse.columns["time_s"])
    (found,) = forecasts(fit, [item], prepared)
    assert np.flatnonzero(item.recorded).tolist() == list(range(0, len(spread), 5))
    assert np.isfinite(found.residual).sum() == item.recorded[-len(found.residual) :].sum()
    assert named(fine).recorded.all()
