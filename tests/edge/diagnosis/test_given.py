"""edge/diagnosis/prepare.py, readings.py and events.py: runs made ready to be explained."""

from dataclasses import replace

import numpy as np
import pytest

from edge.diagnosis.events import DoorOpening, with_events
from edge.diagnosis.gap import predict
from edge.diagnosis.noise import reading_noise_k, rests, usual_room_c
from edge.diagnosis.prepare import PreparedRuns, over_rows, prepare, smooth
from edge.diagnosis.readings import spikes
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.twin_fit import FittedTwin, begun, fit_twins
from edge.formats.run_file import RecordedRun, cut
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from tests.support.simulated_runs import (
    BOX,
    NOISE,
    Floats,
    as_diagnosis_runs,
    change_run,
    simulate,
    twin_file,
)

ROWS = 64
DOOR_W_K = 20.0


def recordings() -> list[RecordedRun]:
    return [simulate(BOX, seed, ROWS) for seed in (1, 2, 3)]


def prepared(runs: list[RecordedRun], file: TwinFile | None = None) -> PreparedRuns:
    return prepare(file or twin_file(), as_diagnosis_runs(runs, file=file))


def fitted(known: PreparedRuns) -> FittedTwin:
    return fit_twins([begun(known.file)], known.fit_runs, 15)[0]


def checked(
    runs: list[RecordedRun], file: TwinFile | None = None
) -> tuple[PreparedRuns, tuple[DoorOpening, ...]]:
    """Runs without wrong readings, and doors that were opened."""
    known = prepared(runs, file)
    return with_events(known, fitted(known))


def with_readings(run: RecordedRun, added: dict[int, float]) -> RecordedRun:
    temp = run.columns["temp_air_c"].copy()
    for row, more in added.items():
        temp[row] += more
    return change_run(run, temp_air_c=temp)


def opened(run: RecordedRun) -> tuple[RecordedRun, slice]:
    """The run of the plain box with its door open for four rows, and which: where it is warmest and no input
    changes, as what comes with a change may be the change's own."""
    columns, rows = run.columns, len(run)
    excess = columns["temp_air_c"] - columns["temp_ambient_c"]
    moved = sum(np.abs(np.diff(columns[key])) for key in ("heater_duty", "fan_on", "light"))
    still = np.convolve(moved, np.ones(10), "valid") == 0.0
    first = int(np.argmax(np.where(still, excess[: len(still)], 0.0))) + 3
    door = np.zeros((1, rows - 1))
    door[0, first : first + 4] = 1.0
    twin = BoxTwin(effects={**BOX, "door_opening": {"G_door": DOOR_W_K}})
    temp = twin.rollout(
        columns["temp_air_c"][:1],
        *(columns[key][None, :-1] for key in ("heater_duty", "fan_on")),
        columns["temp_ambient_c"][:-1],
        conditions={"door_open": door},
    )[0]
    noise = NOISE.sensor_k * np.random.default_rng(4).standard_normal(rows - 1)
    measured = np.concatenate([columns["temp_air_c"][:1], temp + noise])
    return change_run(run, temp_air_c=measured), slice(first, first + 4)


# what is taken out


def test_plain_runs_are_taken_as_they_are() -> None:
    runs = recordings()
    found, doors = checked(runs)
    assert found.names == ("run_01.csv", "run_02.csv", "run_03.csv")
    assert (found.wrong, doors, found.notes, found.guessed) == (0, (), (), False)
    for i, run in enumerate(runs):
        assert (found.runs.temp[i] == run.columns["temp_air_c"]).all()


@pytest.mark.parametrize("more", [6.0, -4.0])
@pytest.mark.parametrize("row", [0, 2, 40, ROWS - 2, ROWS - 1])
def test_a_reading_that_stands_alone_is_taken_out_wherever_it_is(row: int, more: float) -> None:
    # Run 1 is heated from its first row on, by 2 K a row at first: its first reading matters most.
    runs = recordings()
    found, _ = checked([with_readings(runs[0], {row: more}), *runs[1:]])
    assert np.flatnonzero(np.isnan(found.runs.temp[0])).tolist() == [row]
    assert found.wrong == 1
    assert found.notes == (
        "1 temperature of the training runs can't be what the air had and counted as missing",
    )


def test_several_wrong_readings_are_all_taken_out() -> None:
    runs = recordings()
    bad = [with_readings(runs[0], {0: 8.0, 40: 6.0, 60: -4.0}), with_readings(runs[1], {20: 3.0}), runs[2]]
    found, _ = checked(bad)
    taken = [np.flatnonzero(np.isnan(temp)).tolist() for temp in found.runs.temp]
    assert taken == [[0, 40, 60], [20], []]
    assert found.wrong == 4
    assert found.notes[0].startswith("4 temperatures")


def test_a_fast_box_that_is_switched_on_and_off_has_no_wrong_readings() -> None:
    # Bare air warms by 20 K within a row of full heat, and is back two rows later.
    bare = {"wall_loss": {"UA": 5.0}}
    duty = np.zeros(ROWS)
    duty[[0, 10, 30, 31, 50]] = 1.0
    again = []
    for seed in (1, 2):
        run = change_run(simulate(bare, seed, ROWS), heater_duty=duty, fan_on=np.zeros(ROWS))
        room = run.columns["temp_ambient_c"]
        temp = BoxTwin(effects=bare).rollout(room[:1], duty[None, :-1], np.zeros((1, ROWS - 1)), room[:-1])[0]
        again.append(change_run(run, temp_air_c=np.concatenate([room[:1], temp])))
    assert max(run.columns["temp_air_c"][1] for run in again) > 35.0
    assert checked(again, twin_file(bare))[0].wrong == 0


def lone(off_k: float, duty: Floats | None = None) -> RunBatch:
    temp = np.full((1, 21), 25.0) + 0.02 * np.random.default_rng(1).standard_normal((1, 21))
    temp[0, 10] += off_k
    zeros = np.zeros((1, 20))
    return RunBatch(temp, zeros if duty is None else duty, zeros, np.full((1, 20), 20.0))


@pytest.mark.parametrize(("off_k", "is_one"), [(0.5, False), (1.4, False), (1.7, True), (-1.7, True)])
def test_a_peak_of_one_row_is_a_spike_from_1_5_k_on(off_k: float, is_one: bool) -> None:
    assert np.argwhere(spikes(lone(off_k))).tolist() == ([[0, 10]] if is_one else [])


def test_a_peak_that_a_pulse_of_heat_makes_is_none() -> None:
    pulse = np.zeros((1, 20))
    pulse[0, 9] = 1.0
    assert not spikes(lone(8.0, pulse)).any()


def test_a_run_of_nothing_but_holes_has_no_spikes() -> None:
    runs = lone(5.0)
    temp = np.full_like(runs.temp, np.nan)
    temp[0, [0, 20]] = 21.0
    assert not spikes(replace(runs, temp=temp)).any()


# doors


def test_a_door_is_found_becomes_a_column_and_is_in_the_free_run() -> None:
    runs = recordings()
    first, rows = opened(runs[0])
    found, [door] = checked([first, *runs[1:]])
    assert (door.run, door.from_s, door.to_s) == ("run_01.csv", 60.0 * rows.start, 60.0 * rows.stop)
    assert np.flatnonzero(found.runs.conditions["door_open"][0]).tolist() == [*range(rows.start, rows.stop)]
    assert not found.runs.conditions["door_open"][1:].any()
    with_door, run = {**BOX, "door_opening": {"G_door": DOOR_W_K}}, found.train[0].run
    closed, open_ = (missed_k(twin_file(effects), run) for effects in (BOX, with_door))
    assert open_ < 0.5 * closed


def missed_k(file: TwinFile, run: RecordedRun) -> float:
    shown = predict(file, NamedRun("run", run, run.columns["time_s"]), run.columns["temp_ambient_c"])
    return float(np.sqrt(np.nanmean((run.columns["temp_air_c"] - shown) ** 2)))


def test_a_door_that_was_recorded_is_kept_beside_one_that_was_found() -> None:
    runs = recordings()
    first, rows = opened(runs[0])
    door = np.zeros(ROWS)
    door[5:8] = 1.0
    listed = [change_run(run, door_open=door if run is runs[1] else np.zeros(ROWS)) for run in runs[1:]]
    found, _ = checked([change_run(first, door_open=np.zeros(ROWS)), *listed])
    assert found.runs.conditions["door_open"][0, rows].all()
    assert np.flatnonzero(found.runs.conditions["door_open"][1]).tolist() == [5, 6, 7]


# the room


@pytest.mark.parametrize("measured", [(), (1,)])
def test_where_no_room_was_recorded_each_run_has_its_own(measured: tuple[int, ...]) -> None:
    rooms, runs = (17.0, 21.0, 25.0), []
    noise = NOISE.sensor_k * np.random.default_rng(6).standard_normal(ROWS)
    for run, room in zip(recordings(), rooms, strict=True):
        duty, fan = (run.columns[key][None, :-1] for key in ("heater_duty", "fan_on"))
        temp = BoxTwin(effects=BOX).rollout(np.array([room]), duty, fan, room)[0]
        known = np.full(ROWS, room) if len(runs) in measured else None
        runs.append(change_run(run, temp_air_c=np.append(room, temp) + noise, temp_ambient_c=known))
    found = prepared(runs)
    assert [*np.flatnonzero(~found.open_rooms)] == [*measured]
    assert found.with_rooms(fitted(found).starts).ambient[:, 0] == pytest.approx(rooms, abs=0.2)


def wandering(noise_k: float) -> tuple[Floats, Floats]:
    draw = np.random.default_rng(2)
    true = 20.0 + np.cumsum(0.02 * draw.standard_normal((3, 300)), axis=1)
    return true, true + noise_k * draw.standard_normal(true.shape)


@pytest.mark.parametrize("noise_k", [0.05, 0.3])
def test_a_room_seen_through_noise_is_seen_better_by_its_neighbours(noise_k: float) -> None:
    true, measured = wandering(noise_k)
    # A level that wanders by 0.02 K a row is known by some noise / 0.02 rows: a good third of the noise.
    assert np.std(smooth(measured) - true) < 0.6 * noise_k


def test_a_room_that_is_known_exactly_or_stands_still_stays_as_it_is() -> None:
    true, _ = wandering(0.0)
    assert smooth(true) == pytest.approx(true, abs=0.02)
    still = np.full((2, 50), 21.5)
    assert (smooth(still) == still).all()
    short = np.array([[20.0, 25.0, 21.0]])
    assert (smooth(short) == short).all()


def test_between_two_readings_the_room_is_half_way() -> None:
    assert over_rows(np.array([[20.0, 22.0, 23.0]])).tolist() == [[21.0, 22.5, 23.0]]
    assert over_rows(np.full((1, 30), 21.0)).tolist() == [[21.0] * 30]


# days, rooms that no one measured, and fits whose twin runs away


def test_days_are_counted_from_the_first_run_unless_the_file_says() -> None:
    runs = recordings()
    later = [
        change_run(run, facts={"start_utc": f"2026-07-0{3 - i}T08:00:00Z"}) for i, run in enumerate(runs)
    ]
    assert prepared(later).file.day0_utc == 1782892800.0  # 2026-07-01 08:00 UTC, the third run's
    assert prepared(later, replace(twin_file(), day0_utc=1.0)).file.day0_utc == 1.0
    timeless = [replace(run, facts={}) for run in runs]
    assert prepared(timeless).file.day0_utc is None


@pytest.mark.parametrize(
    ("temps", "room_c", "is_at_rest"),
    [
        ([21.0, 21.0, 21.0, 21.0, 30.0, 40.0], 21.0, True),
        ([50.0, 45.0, 40.0, 30.0, 60.0], 24.0, False),  # in the middle of something
        ([50.0, 55.0, 60.0, 65.0], 24.0, False),  # warmer than any room
        ([12.0, 9.0, 6.0, 4.0, 12.0], 8.5, False),  # in a shed
        ([21.0, 21.0, np.nan, 21.0, 21.0, 40.0], 21.0, True),
    ],
)
def test_a_run_that_begins_hot_is_in_no_hot_room(temps: list[float], room_c: float, is_at_rest: bool) -> None:
    temp = np.array(temps)
    assert rests(temp, np.zeros(len(temp)), 0.05) == is_at_rest
    assert usual_room_c(temp, is_at_rest) == room_c


def from_the_middle(run: RecordedRun) -> RecordedRun:
    """From where it is hottest of its first rows, of a room that nobody recorded."""
    later = cut(run, int(np.argmax(run.columns["temp_air_c"][:150])), len(run))
    return change_run(later, facts={"temp_ambient_c": "none"}, temp_ambient_c=None)


@pytest.mark.slow
def test_the_room_of_a_run_that_begins_hot_is_found() -> None:
    run = from_the_middle(simulate(BOX, 3, 200))
    file = replace(
        twin_file(),
        effects={"wall_loss": {"UA": Value(2.0, fit=True)}, "extra_capacity": {"kC": Value(20.0, fit=True)}},
    )
    known = prepared([run], file)
    assert not known.rests.any()
    found = fitted(known)
    assert found.starts[0, -1] == pytest.approx(21.0, abs=2.5)
    assert found.file.values()["effects", "wall_loss", "UA"].value == pytest.approx(4.0, rel=0.25)


def test_a_twin_that_runs_away_is_very_bad_and_ends_no_fit() -> None:
    """Heat that grows by 250 W/K about the air's own temperature."""
    still = np.zeros(ROWS)
    temp = 25.0 + 0.1 * np.random.default_rng(1).standard_normal(ROWS)
    run = change_run(simulate(BOX, 1, ROWS), temp_air_c=temp, heater_duty=still + 0.2, fan_on=still)
    cold = {"P_x": Value(-100.0, fit=True), "T_x": Value(25.0), "w_x": Value(0.2)}
    file = replace(twin_file(), effects={**twin_file().effects, "unnamed_heat": cold})
    (lost,) = fit_twins([begun(file)], prepared([run], file).fit_runs, 0)
    assert lost.rmse_k > 100.0
    assert np.isfinite(lost.x).all()


def unheated(temp: Floats) -> RecordedRun:
    return RecordedRun({"temp_air_c": temp})


def test_noise_is_that_of_readings_and_at_least_their_rounding() -> None:
    slow = 20.0 + 5.0 * np.sin(np.arange(400) / 60.0)
    noisy = slow + 0.1 * np.random.default_rng(0).standard_normal(400)
    assert reading_noise_k([unheated(noisy)]) == pytest.approx(0.1, rel=0.2)
    stepped = np.round(slow * 2.0) / 2.0
    assert reading_noise_k([unheated(stepped)]) == pytest.approx(0.5 / 12**0.5)
    stepped[1::9] = 0.5 * (stepped[:-1:9] + stepped[1::9])[: len(stepped[1::9])]  # as resampling leaves them
    assert reading_noise_k([unheated(stepped)]) == pytest.approx(0.5 / 12**0.5)


@pytest.mark.parametrize(
    ("temp", "is_resting"),
    [
        ([20.0] * 5 + list(np.linspace(20.0, 40.0, 50)), True),
        (list(np.linspace(20.0, 40.0, 55)), False),  # it moves already
        ([40.0] * 5 + list(np.linspace(40.0, 20.0, 50)), False),  # it holds still, and was heated before
    ],
)
def test_a_run_that_begins_at_rest_is_recognised(temp: list[float], is_resting: bool) -> None:
    assert rests(np.array(temp), np.zeros(len(temp)), 0.01) is is_resting


@pytest.mark.parametrize(("first", "is_resting"), [(0.0, True), (0.2, False), (0.8, True)])
def test_a_run_that_is_held_at_a_working_point_does_not_rest(first: float, is_resting: bool) -> None:
    """A late box that gets warmer by the heat of its first row rested before."""
    duty = np.where(np.arange(80) < 30, first, 0.8)
    temp = 30.0 + 0.3 * np.maximum(np.arange(80) - 30, 0)
    assert rests(temp, duty, 0.05) is is_resting
