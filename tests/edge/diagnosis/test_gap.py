"""edge/diagnosis/gap.py: free runs from the first rows of a run, what they miss, and what they must."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.gap import START_ROWS, RunForecast, alone, errors, floor_squares, forecast, one_step
from edge.diagnosis.runs import NamedRun
from edge.formats.run_file import RecordedRun, resample
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from tests.support.simulated_runs import (
    BOX,
    NOISE,
    QUIET,
    STEP_S,
    Floats,
    change_run,
    coloured_noise,
    simulate,
    twin_file,
)

PLAIN = BoxTwin(effects=BOX)
SLOW = {"extra_capacity": {"kC": 10.0}, "wall_mass": {"C_w": 6000.0, "G_in": 9.0, "G_out": 7.2},
        "heater_lag": {"tau_h": 200.0}, "heater_deadtime": {"d_h": 75.0}}  # fmt: skip
ROWS = 80


def named(run: RecordedRun) -> NamedRun:
    return NamedRun(str(run.path), run, run.columns["time_s"])


def free_run(twin: BoxTwin, run: RecordedRun) -> RunForecast:
    return forecast(twin, named(run), run.columns["temp_ambient_c"])


def measured_only(run: RecordedRun, rows: object) -> RecordedRun:
    """The run with temperatures in these rows alone."""
    temp = np.full(len(run), np.nan)
    temp[rows] = run.columns["temp_air_c"][rows]
    return change_run(run, temp_air_c=temp)


# free runs


@pytest.mark.parametrize("effects", [BOX, SLOW], ids=["one state", "walls, a slow and late heater"])
def test_the_twin_that_made_a_run_without_noise_reproduces_it(effects: dict[str, dict[str, float]]) -> None:
    run = simulate(effects, 1, ROWS, QUIET)
    found = free_run(BoxTwin(effects=effects), run)
    # What is hidden starts at rest at the room's temperature, as the box here did.
    assert np.abs(found.residual).max() < 0.01
    assert len(found.residual) == ROWS - START_ROWS


@pytest.mark.parametrize(
    ("known", "start"),
    [
        ([0], 0),
        ([0, 1], 1),
        (range(9), 8),
        (range(10), 9),
        (range(11), 9),
        (range(ROWS), 9),
        ([3], 3),
        ([3, 4], 4),
        ([0, 2], 0),  # up to the first hole
        ([*range(4), *range(5, ROWS)], 3),
        (range(30, ROWS), 39),  # ten rows from the first that was measured
        ([ROWS - 1], ROWS - 1),
    ],
)
def test_a_forecast_begins_at_the_last_of_the_first_rows_measured_without_a_hole(
    known: object, start: int
) -> None:
    run = measured_only(simulate(BOX, 1, ROWS), list(known))  # type: ignore[call-overload]
    found = free_run(PLAIN, run)
    assert found.start == start
    assert len(found.predicted) == ROWS
    assert np.isfinite(found.predicted).all()
    assert len(found.residual) == ROWS - 1 - start
    assert found.predicted[start] == run.columns["temp_air_c"][start]


@pytest.mark.parametrize(("from_row", "holes", "start"), [(40, (), 39), (40, (39, 38), 37), (0, (), 9)])
def test_a_run_that_judges_from_a_row_on_is_known_before_it(
    from_row: int, holes: tuple[int, ...], start: int
) -> None:
    run = measured_only(simulate(BOX, 1, ROWS), [k for k in range(ROWS) if k not in holes])
    found = forecast(PLAIN, replace(named(run), from_s=60.0 * from_row), run.columns["temp_ambient_c"])
    assert found.start == start
    assert len(found.residual) == ROWS - 1 - start


def test_up_to_its_start_a_forecast_is_what_was_measured() -> None:
    run = simulate(BOX, 1, ROWS)
    found = free_run(PLAIN, run)
    assert (found.predicted[:START_ROWS] == run.columns["temp_air_c"][:START_ROWS]).all()


def test_temperatures_behind_the_start_are_not_used() -> None:
    run = simulate(SLOW, 1, ROWS)
    blind = measured_only(run, slice(START_ROWS))
    twin = BoxTwin(effects=SLOW)
    assert free_run(twin, run).predicted == pytest.approx(free_run(twin, blind).predicted, abs=0.0)
    assert np.isnan(free_run(twin, blind).residual).all()


def test_a_run_without_a_fan_column_has_a_fan_that_stands_still() -> None:
    run = simulate(BOX, 1, ROWS, fan=False)
    assert free_run(PLAIN, change_run(run, fan_on=None)).predicted == pytest.approx(
        free_run(PLAIN, run).predicted, abs=0.0
    )


def test_the_room_that_is_given_is_the_one_that_counts() -> None:
    run = simulate(BOX, 1, ROWS, QUIET)
    without = change_run(run, temp_ambient_c=None)
    given = forecast(PLAIN, named(without), run.columns["temp_ambient_c"])
    assert given.predicted == pytest.approx(free_run(PLAIN, run).predicted, abs=0.0)
    warmer = forecast(PLAIN, named(run), run.columns["temp_ambient_c"] + 3.0)
    assert (warmer.predicted - given.predicted)[-1] == pytest.approx(3.0, abs=0.1)  # many time constants on


# what a right twin must miss


def monte_carlo_k(twin: BoxTwin, runs: RunBatch, count: int) -> Floats:
    """Return the errors of free runs in each row [N], from a known start, by as many draws of all noise."""
    draw, shape = np.random.default_rng(3), (count, runs.duty.shape[1])
    wide = [np.repeat(column, count, axis=0) for column in (runs.duty, runs.fan, runs.ambient)]
    duty, fan, room = wide
    start = np.full(len(twin.states), 22.0)
    heat_w = np.stack([coloured_noise(draw, shape[1], NOISE) for _ in range(count)])
    power = duty * (1.0 + NOISE.power_share * draw.standard_normal((count, 1)))
    true_room = room + NOISE.room_k * draw.standard_normal(shape)
    true = twin.rollout(start, power, fan, true_room, heat_w / twin.system.air_capacity_j_k)
    missed = true + NOISE.sensor_k * draw.standard_normal(shape) - twin.rollout(start, duty, fan, room)
    return np.sqrt(np.mean(missed**2, axis=0))


THREE_STATES = {key: SLOW[key] for key in ("extra_capacity", "wall_mass", "heater_lag")}


@pytest.mark.parametrize("effects", [BOX, THREE_STATES], ids=["one state", "three states"])
def test_the_noise_floor_is_what_a_right_twin_misses_by(effects: dict[str, dict[str, float]]) -> None:
    twin, run = BoxTwin(effects=effects), simulate(effects, 1, ROWS)
    runs = alone(named(run), free_run(twin, run), run.columns["temp_ambient_c"])
    seen = np.ones(ROWS, dtype=bool)
    floor = np.sqrt(floor_squares(twin, NOISE, runs, seen))
    drawn = monte_carlo_k(twin, runs, 2000)
    # A standard deviation from 2000 draws is known to 1 / sqrt(4000) = 1.6 %: 3.5 of that for 79 rows.
    assert floor == pytest.approx(drawn, rel=0.055)
    assert floor[0] > NOISE.sensor_k
    assert floor.max() > 1.5 * NOISE.sensor_k  # in a warm box with the fan off heat and mains make most of it


def test_rows_without_a_temperature_do_not_count_into_the_floor() -> None:
    run = simulate(BOX, 1, ROWS)
    runs = alone(named(run), free_run(PLAIN, run), run.columns["temp_ambient_c"])
    every = floor_squares(PLAIN, NOISE, runs, np.ones(ROWS, dtype=bool))
    seen = np.arange(ROWS) >= 40
    assert floor_squares(PLAIN, NOISE, runs, seen) == pytest.approx(every[39:])
    assert len(floor_squares(PLAIN, NOISE, runs, np.zeros(ROWS, dtype=bool))) == 0


# one step ahead


def steps_ahead(run: RecordedRun, seen: object = slice(None)) -> Floats:
    known = measured_only(run, seen)
    guess = free_run(PLAIN, known)
    runs = alone(named(known), guess, known.columns["temp_ambient_c"])
    return one_step(PLAIN, NOISE, runs, np.isfinite(known.columns["temp_air_c"]))


def test_one_step_ahead_misses_less_than_a_free_run_and_no_less_than_the_sensor_does() -> None:
    run = simulate(BOX, 1, 150)
    measured = run.columns["temp_air_c"]
    ahead_k = np.std(measured[10:] - steps_ahead(run)[10:])
    free_k = np.sqrt(np.mean(free_run(PLAIN, run).residual ** 2))
    assert 0.9 * NOISE.sensor_k < ahead_k < free_k


def test_one_step_ahead_is_told_by_the_rows_before_alone() -> None:
    run = simulate(BOX, 1, ROWS)
    temp = run.columns["temp_air_c"].copy()
    temp[50:] += 5.0
    plain, other = steps_ahead(run), steps_ahead(change_run(run, temp_air_c=temp))
    assert plain[:51] == pytest.approx(other[:51], abs=1e-12)
    assert other[51] > plain[51] + 0.1


def test_where_nothing_is_measured_any_more_one_step_ahead_runs_free() -> None:
    run = simulate(BOX, 1, ROWS)
    blind = steps_ahead(run, slice(1))
    free = PLAIN.rollout(
        run.columns["temp_air_c"][:1],
        *(run.columns[key][None, :-1] for key in ("heater_duty", "fan_on")),
        run.columns["temp_ambient_c"][:-1],
    )[0]
    assert blind[1:] == pytest.approx(free, abs=1e-9)


# errors


def made(residual: object, start: int = 0, name: str = "a.csv") -> RunForecast:
    values = np.asarray(residual, float)
    return RunForecast(name, start, 20.0 + values, np.full(len(values), 20.0))


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
    assert errors([made([0.0, np.nan])]) is None
    assert errors([made([0.0])]) is None
    assert errors([]) is None


def test_one_run_alone_has_no_hole_and_all_its_conditions() -> None:
    run = measured_only(simulate(BOX, 1, ROWS), slice(2))
    guess = free_run(twin_file().twin(), run)
    runs = alone(named(run), guess, run.columns["temp_ambient_c"])
    assert runs.temp.shape == (1, ROWS)
    assert (runs.temp[0] == guess.predicted).all()
    assert runs.duty.shape == (1, ROWS - 1)
    assert runs.conditions["utc"][0, 1] - runs.conditions["utc"][0, 0] == STEP_S
    assert {"light", "utc"} <= set(runs.conditions)
    holes = change_run(run, light=np.where(np.arange(ROWS) == 7, np.nan, run.columns["light"]))
    held = alone(named(holes), guess, run.columns["temp_ambient_c"])
    assert held.conditions["light"][0, 7] == run.columns["light"][6]
    assert runs.has_ambient


def test_between_the_rows_of_a_coarser_recording_nothing_is_missed() -> None:
    fine = simulate(SLOW, 1, ROWS, QUIET)
    coarse = replace(fine, columns={name: column[::5] for name, column in fine.columns.items()})
    spread = resample(coarse, 60.0)
    item = NamedRun("coarse", spread, coarse.columns["time_s"])
    residual = forecast(BoxTwin(effects=SLOW), item, spread.columns["temp_ambient_c"]).residual
    assert np.flatnonzero(item.recorded).tolist() == list(range(0, len(spread), 5))
    assert np.isfinite(residual).sum() == item.recorded[-len(residual) :].sum()
    assert named(fine).recorded.all()
