"""edge/diagnosis/runs.py and around it: recordings read, refused, cut, and what they can't tell."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from history_records import START_UTC, HandClock, History, tick
from training_runs import box_run

from edge.core.errors import DataError
from edge.core.messages import Command, Echo, Event, Reading, ReadingQuality, Severity
from edge.diagnosis.history_runs import history_runs
from edge.diagnosis.runs import (
    GAP_S,
    LONGEST_ROWS,
    LONGEST_S,
    PIECE_ROWS,
    USABLE_ROWS,
    WHOLE_S,
    DiagnosisRuns,
    pieces,
    read_runs,
)
from edge.formats.run_file import RecordedRun, absence_facts, data_sha256, write_run
from edge.storage import Storage
from edge.storage.runs import export_run, export_stretches, name_run
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

TWIN = TwinFile()
FIVE = ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")


def recorded(path: Path, run: RecordedRun | None = None, **columns: object) -> Path:
    """A run file of a box of known physics, with some columns replaced (None: without it)."""
    run = run or box_run(1)
    replaced = {**run.columns, **{name: np.asarray(values, float) for name, values in columns.items()}}
    facts = {key: value for key, value in run.facts.items() if key != "validate_from_s"}
    kept = {name: values for name, values in replaced.items() if columns.get(name, 0) is not None}
    write_run(absence_facts(RecordedRun(kept, facts)), path)
    return path


def edited(path: Path, line: int, cells: Mapping[str, str]) -> Path:
    """The file with some cells of one line (counted from 1) replaced."""
    lines = path.read_text().splitlines()
    header = next(text for text in lines if not text.startswith("#")).split(",")
    row = lines[line - 1].split(",")
    for name, cell in cells.items():
        row[header.index(name)] = cell
    lines[line - 1] = ",".join(row)
    path.write_text("\n".join(lines) + "\n")
    return path


def read(*train: Path, test: Sequence[Path] = (), twin: TwinFile = TWIN) -> DiagnosisRuns:
    return read_runs(train, test, twin)


@pytest.fixture
def train(tmp_path: Path) -> Path:
    return recorded(tmp_path / "train.csv")


@pytest.fixture
def test(tmp_path: Path) -> Path:
    return recorded(tmp_path / "test.csv", box_run(2, role="test"))


# what comes out


def test_run_files_come_back_by_name_with_their_numbers(train: Path, test: Path) -> None:
    runs = read(train, test=[test])
    assert [named.name for named in (*runs.train, *runs.test)] == ["train.csv", "test.csv"]
    assert runs.train[0].run.columns["temp_air_c"] == pytest.approx(box_run(1).columns["temp_air_c"])
    assert runs.notes == ()
    assert runs.data_sha256 == data_sha256([box_run(1)])  # of the numbers, wherever the file lies


def test_a_training_run_ends_where_its_validation_begins(tmp_path: Path) -> None:
    write_run(box_run(1), tmp_path / "a.csv")  # of its 90 rows the last fifth validates
    named = read(tmp_path / "a.csv").train[0]
    assert len(named.run) == 72
    assert "validate_from_s" not in named.run.facts  # nobody cuts it a second time


def test_a_test_run_may_have_temperatures_in_its_first_rows_only(train: Path, tmp_path: Path) -> None:
    temps = box_run(2).columns["temp_air_c"].copy()
    temps[2:] = np.nan
    blind = recorded(tmp_path / "test.csv", box_run(2, role="test"), temp_air_c=temps)
    assert len(read(train, test=[blind]).test[0].run) == 90


@pytest.mark.parametrize("step_s", [10.0, 60.0, 600.0])
def test_rows_keep_their_own_step_whatever_that_of_the_twin_is(train: Path, step_s: float) -> None:
    runs = read(train, twin=replace(TWIN, sample_s=step_s))
    assert runs.step_s == 60.0
    assert len(runs.train[0].run) == 90
    assert runs.notes == ()


def test_runs_of_several_periods_get_one_step_and_their_own_rows_are_found_again(
    train: Path, tmp_path: Path
) -> None:
    fine = recorded(tmp_path / "fine.csv", box_run(1, rows=60), time_s=10.0 * np.arange(60))
    runs = read(train, fine)  # most rows are 60 s apart
    named = runs.train[1]
    assert runs.step_s == 60.0
    assert len(named.run) == 10  # 0, 60, .. 540 s; the last row is at 590 s
    assert runs.notes == ("fine.csv has rows 10 s apart and is resampled to 60 s",)
    # A straight line is the same at any period.
    assert named.at_rows(named.run.columns["time_s"])[:55] == pytest.approx(10.0 * np.arange(55))


def test_a_long_run_is_thinned_to_what_a_fit_can_take(tmp_path: Path) -> None:
    rows = 2 * LONGEST_ROWS
    path = recorded(tmp_path / "long.csv", box_run(1, rows=rows), time_s=10.0 * np.arange(rows))
    runs = read(path)
    assert runs.step_s == 20.0
    assert len(runs.train[0].run) == LONGEST_ROWS


def test_a_run_too_short_to_be_of_use_is_left_out_and_that_is_told(train: Path, tmp_path: Path) -> None:
    runs = read(train, recorded(tmp_path / "stub.csv", box_run(2, rows=PIECE_ROWS - 1)))
    assert [named.name for named in runs.train] == ["train.csv"]
    assert runs.notes == (f"stub.csv is left out: it has 4 temperatures, {PIECE_ROWS} are of use",)


def test_rows_of_a_regular_run_are_given_back_exactly(train: Path) -> None:
    named = read(train).train[0]
    temps = named.run.columns["temp_air_c"]
    assert (named.at_rows(temps) == temps).all()


def test_two_files_of_one_name_are_told_apart(tmp_path: Path) -> None:
    for folder, seed in (("a", 1), ("b", 2)):
        (tmp_path / folder).mkdir()
        recorded(tmp_path / folder / "run.csv", box_run(seed))
    runs = read(tmp_path / "a" / "run.csv", tmp_path / "b" / "run.csv")
    assert [named.name for named in runs.train] == [str(tmp_path / f / "run.csv") for f in "ab"]


# pieces


def timed(time_s: Sequence[float]) -> RecordedRun:
    run = box_run(1, rows=len(time_s))
    return RecordedRun({**run.columns, "time_s": np.array(time_s)}, {"start_utc": "2026-07-01T12:00:00Z"})


@pytest.mark.parametrize(("gap_s", "count"), [(GAP_S - 1.0, 1), (GAP_S, 1), (GAP_S + 1.0, 2)])
def test_a_run_is_cut_where_rows_are_missing_for_long(gap_s: float, count: int) -> None:
    assert len(pieces(timed([0.0, 60.0, 60.0 + gap_s, 120.0 + gap_s]))) == count


@pytest.mark.parametrize(("last_s", "count"), [(WHOLE_S - 60, 1), (WHOLE_S, 1), (WHOLE_S + 60, 3)])
def test_two_days_stay_one_recording_and_more_become_days(last_s: float, count: int) -> None:
    parts = pieces(timed(np.arange(0.0, last_s + 1.0, 60.0).tolist()))
    assert len(parts) == count
    assert max(part.columns["time_s"][-1] for part in parts) <= (WHOLE_S if count == 1 else LONGEST_S)


def test_ten_days_of_five_minutes_stay_one_recording() -> None:
    assert len(pieces(timed(np.arange(0.0, 5.0 * WHOLE_S + 1.0, 300.0).tolist()), step_s=300.0)) == 1


def test_pieces_share_no_row_and_say_when_they_began() -> None:
    run = timed([0.0, 60.0, 120.0, 3600.0, 3660.0])
    first, second = pieces(run)
    both = np.concatenate([part.columns["temp_air_c"] for part in (first, second)])
    assert both.tolist() == run.columns["temp_air_c"].tolist()
    assert second.columns["time_s"].tolist() == [0.0, 60.0]
    assert second.start_utc == run.start_utc + 3600.0


def test_a_long_test_run_stays_whole_as_its_later_part_may_have_no_temperature(
    train: Path, tmp_path: Path
) -> None:
    rows = int(1.2 * WHOLE_S / 60.0)
    long = recorded(tmp_path / "long.csv", box_run(2, rows=rows, role="test"))
    runs = read(train, test=[long])
    assert [named.name for named in runs.test] == ["long.csv"]
    assert [named.name for named in read(recorded(long, box_run(2, rows=rows))).train] == [
        "long.csv (1 of 3)",
        "long.csv (2 of 3)",
        "long.csv (3 of 3)",
    ]


# what is refused


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({"heater_duty": "35"}, "line 4: heater_duty: 35 is not in 0..1; is the column in percent?"),
        ({"heater_duty": "1.01"}, "line 4: heater_duty: 1.01 is not in 0..1"),
        ({"heater_duty": "-0.01"}, "line 4: heater_duty: -0.01 is not in 0..1"),
        ({"heater_duty": ""}, "line 4: heater_duty: empty is unknown"),
        ({"heater_duty": "nan"}, "line 4: heater_duty: 'nan' is no number"),
        ({"heater_duty": "inf"}, "line 4: heater_duty: 'inf' is no number"),
        ({"fan_on": "100"}, "line 4: fan_on: 100 is not in 0..1; is the column in percent?"),
        (
            {"time_s": "0"},
            "line 4: time_s: 0 does not come after the row before: one time stands there twice",
        ),
        ({"time_s": "-60"}, "line 4: time_s: -60 does not come after the row before: time goes backwards"),
        ({"time_s": ""}, "line 4: time_s: empty is no time"),
    ],
)
def test_a_wrong_cell_is_named_by_file_line_and_column(
    tmp_path: Path, cells: dict[str, str], message: str
) -> None:
    path = edited(recorded(tmp_path / "run.csv"), 4, cells)  # line 1: role, 2: header, 3: row 0
    with pytest.raises(DataError, match=rf"run\.csv: ({message})"):
        read(path)


@pytest.mark.parametrize(
    ("column", "change", "message"),
    [
        (
            "temp_air_c",
            lambda t: t + 273.15,
            "295.15 is not a plausible air temp.* in degC; is it kelvin",
        ),
        (
            "temp_ambient_c",
            lambda t: t + 273.15,
            "295.15 is not a plausible room.* in degC; is it kelvin",
        ),
        (
            "temp_ambient_c",
            lambda t: 1.8 * t + 32.0,
            "71.6 is not a plausible room.* in degC; is it Fahr",
        ),
        ("temp_air_c", lambda t: t - 272.0, "-250 is not a plausible air temperature in degC$"),
    ],
)
def test_another_unit_is_refused_and_guessed(tmp_path: Path, column: str, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = recorded(tmp_path / "run.csv", **{column: change(box_run(1).columns[column])})
    with pytest.raises(DataError, match=rf"run\.csv: line 3: {column}: {message}"):
        read(path)


@pytest.mark.parametrize(("slips", "refused"), [(1, False), (9, False), (10, True)])
def test_a_few_slips_of_a_sensor_are_missing_and_many_are_another_unit(
    tmp_path: Path, slips: int, refused: bool
) -> None:
    temps = box_run(1).columns["temp_air_c"].copy()  # 90 of them
    temps[5 : 5 + slips] = 85.0  # what a DS18B20 says after its power failed
    path = recorded(tmp_path / "run.csv", temp_air_c=temps)
    if refused:
        with pytest.raises(DataError, match="line 8: temp_air_c: 85 is not a plausible air temperature"):
            read(path)
        return
    runs = read(path)
    assert np.isnan(runs.train[0].run.columns["temp_air_c"][5 : 5 + slips]).all()
    assert runs.notes[0].startswith(f"{path}: line 8: temp_air_c: 85 degC can't be; {slips} such cell")


@pytest.mark.parametrize(("temp", "kept"), [(-20.0, True), (-20.1, False), (80.0, True), (80.1, False)])
def test_the_range_of_a_temperature_is_the_sensors(tmp_path: Path, temp: float, kept: bool) -> None:
    temps = box_run(1).columns["temp_air_c"].copy()
    temps[5] = temp
    read_back = read(recorded(tmp_path / "run.csv", temp_air_c=temps)).train[0].run.columns["temp_air_c"]
    assert np.isfinite(read_back[5]) == kept


@pytest.mark.parametrize(
    ("humidity", "message"),
    [
        (0.45, "line 3: rel_humidity_pct: 0.45 is no humidity of a room in percent; is it a share of 1"),
        (1.0, "is it a share of 1"),
        (101.0, "line 3: rel_humidity_pct: 101 is not in 0..100"),
        (1.1, None),
        (100.0, None),
        (0.0, None),
    ],
)
def test_humidity_is_in_percent(tmp_path: Path, humidity: float, message: str | None) -> None:
    path = recorded(tmp_path / "run.csv", rel_humidity_pct=np.full(90, humidity))
    if message is None:
        assert len(read(path).train) == 1
    else:
        with pytest.raises(DataError, match=message):
            read(path)


def test_time_in_milliseconds_is_guessed(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"time_s: rows are 60000 s apart, .*is it in milliseconds"):
        read(recorded(tmp_path / "ms.csv", time_s=60_000.0 * np.arange(90)))


def test_time_in_minutes_is_guessed(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"min\.csv: time_s: the runs last 89 s, .*is time_s in seconds"):
        read(recorded(tmp_path / "min.csv", time_s=np.arange(90)))


def test_nothing_measured_is_refused(train: Path, tmp_path: Path) -> None:
    empty = recorded(tmp_path / "empty.csv", box_run(2), temp_air_c=np.full(90, np.nan))
    for train_files, test_files in (([empty], []), ([train], [empty])):
        with pytest.raises(DataError, match=r"empty\.csv: temp_air_c: nothing was measured"):
            read(*train_files, test=test_files)


@pytest.mark.parametrize("rows", [10, USABLE_ROWS - 1, USABLE_ROWS])
def test_too_few_rows_are_refused_and_counted(tmp_path: Path, rows: int) -> None:
    path = recorded(tmp_path / "short.csv", box_run(1, rows=rows))
    if rows >= USABLE_ROWS:
        assert len(read(path).train[0].run) == rows
        return
    with pytest.raises(DataError, match=rf"short\.csv: {rows} usable rows: .* at least 30"):
        read(path)


def test_a_test_run_is_never_fitted_on(test: Path) -> None:
    with pytest.raises(DataError, match=r"test\.csv: role: a test run is never fitted on"):
        read(test)


def test_no_recording_counts_twice(train: Path, test: Path, tmp_path: Path) -> None:
    copy = recorded(tmp_path / "copy.csv")
    for files, tests in (
        ((train, train), ()),
        ((train,), (train,)),
        ((train, copy), ()),
        ((train,), (copy,)),
    ):
        with pytest.raises(DataError, match=r"\.csv: is the same recording as .*train\.csv"):
            read(*files, test=tests)
    assert len(read(train, test=[test]).test) == 1


def test_one_recording_trains_and_then_tests_where_it_says_from_when(tmp_path: Path) -> None:
    write_run(box_run(1), tmp_path / "a.csv")  # validates from its 73rd row on
    runs = read(tmp_path / "a.csv", test=[tmp_path / "a.csv"])
    first, rest = runs.train[0], runs.test[0]
    assert (len(first.run), len(rest.run)) == (72, 90)
    assert rest.from_s == rest.run.columns["time_s"][72]
    assert (rest.name, rest.rest_of) == (f"a.csv from {rest.from_s:g} s", "a.csv")
    assert first.from_s is None


def test_a_test_run_of_its_own_may_say_from_when_too(train: Path, tmp_path: Path) -> None:
    run = replace(box_run(2), facts={"role": "test", "validate_from_s": "600"})
    write_run(run, tmp_path / "b.csv")
    [named] = read(train, test=[tmp_path / "b.csv"]).test
    assert (named.name, named.from_s, named.rest_of) == ("b.csv", 600.0, "")


@pytest.mark.parametrize(("text", "error"), [("soon", "is no number"), ("1e9", "leaves no row to test on")])
def test_a_test_run_that_judges_from_never_is_refused(
    train: Path, tmp_path: Path, text: str, error: str
) -> None:
    write_run(replace(box_run(2), facts={"role": "test", "validate_from_s": text}), tmp_path / "b.csv")
    with pytest.raises(DataError, match=rf"b\.csv: validate_from_s: .*{error}"):
        read(train, test=[tmp_path / "b.csv"])


def test_the_same_rows_never_train_and_test(tmp_path: Path) -> None:
    for name, from_s in (("a", "3000"), ("b", "1800")):
        write_run(replace(box_run(1), facts={"validate_from_s": from_s}), tmp_path / f"{name}.csv")
    with pytest.raises(DataError, match="is the same recording as"):
        read(tmp_path / "a.csv", test=[tmp_path / "b.csv"])


def test_no_run_at_all_is_refused() -> None:
    with pytest.raises(DataError, match="at least one training run"):
        read()


@pytest.mark.parametrize(
    ("effect", "values", "message"),
    [
        ("led_gain", {"P_led": 20.0}, "light: missing, the twin's led_gain needs it"),
        ("evapotranspiration", {"k_e": 5.0}, "missing, the twin's evapotranspiration needs it"),
        ("ua_drift", {"ua_drift": 0.01}, "start_utc: missing, the twin's ua_drift needs it"),
    ],
)
def test_a_column_that_the_twin_needs_is_asked_for(
    train: Path, effect: str, values: dict[str, float], message: str
) -> None:
    known = {"wall_loss": {"UA": Value(5.0)}, effect: {name: Value(value) for name, value in values.items()}}
    with pytest.raises(DataError, match=rf"train\.csv: .*{message}"):
        read(train, twin=replace(TWIN, effects=known, day0_utc=0.0))


# what these data can't tell

ALL_TOLD = {  # column -> values that hide nothing
    "light": np.repeat([0.0, 1.0, 0.5], 30),
    "rel_humidity_pct": np.linspace(40.0, 60.0, 90),
    "temp_ambient_c": np.linspace(20.0, 23.0, 90),
    "heater_duty": np.repeat([0.0, 0.3, 0.6, 0.9, 0.2], 18),
    "fan_on": np.tile([0.0, 1.0, 0.0], 30),
}


def sentences(tmp_path: Path, **columns: object) -> str:
    """About two training runs a week apart and a test run that hide nothing but `columns`."""
    paths = []
    for number, role in enumerate(("train", "train", "test")):
        start = {"start_utc": f"2026-07-{1 + 7 * number:02}T12:00:00Z"}
        run = box_run(number + 1, role=role)
        paths.append(
            recorded(
                tmp_path / f"{number}.csv",
                replace(run, facts={"role": role} | start),
                **{**ALL_TOLD, **columns},
            )
        )
    return "\n".join(read(*paths[:2], test=paths[2:]).cannot_tell)


def test_data_that_hide_nothing_have_nothing_said_of_them(tmp_path: Path) -> None:
    assert sentences(tmp_path) == ""


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"heater_duty": np.zeros(90)}, "the heater never heats"),
        ({"heater_duty": np.full(90, 0.4)}, "the heater never changes: heater_lag"),
        ({"heater_duty": np.repeat([0.0, 1.0], 45)}, "only off and one level: heater_efficiency"),
        ({"fan_on": np.zeros(90)}, "the fan never runs"),
        ({"fan_on": np.ones(90)}, "the fan never changes"),
        ({"fan_on": None}, "the fan was not recorded and counts as still"),
        ({"temp_ambient_c": None}, "the room temperature was not recorded"),
        ({"temp_ambient_c": np.full(90, 22.0)}, "the room stayed within 0.0 K: constant_heat"),
        ({"light": None}, "the light was not recorded: led_gain"),
        ({"light": np.ones(90)}, "the light never changes: led_gain"),
        ({"rel_humidity_pct": None}, "the humidity was not recorded: evapotranspiration"),
    ],
)
def test_what_an_input_hides_is_said(tmp_path: Path, columns: dict[str, object], said: str) -> None:
    assert said in sentences(tmp_path, **columns)


@pytest.mark.parametrize(("excess_k", "told"), [(1.9, True), (2.0, False)])
def test_an_air_that_stays_near_the_room_tells_no_losses(tmp_path: Path, excess_k: float, told: bool) -> None:
    room = ALL_TOLD["temp_ambient_c"]
    train = recorded(
        tmp_path / "a.csv", temp_ambient_c=room, temp_air_c=room + np.linspace(0.0, excess_k, 90)
    )
    assert ("losses can hardly be told" in "\n".join(read(train).cannot_tell)) == told


@pytest.mark.parametrize(
    ("train", "test", "said"),
    [
        ({"fan_on": np.zeros(90)}, {"fan_on": np.repeat([0.0, 1.0], 45)}, "the fan runs there"),
        ({"fan_on": np.ones(90)}, {}, "the fan stands still there"),
        ({"heater_duty": np.repeat([0.0, 0.5], 45)}, {}, "the heater goes up to 90 % there, to 50 %"),
        ({"temp_air_c": np.linspace(20.0, 30.0, 90)}, {"temp_air_c": np.full(90, 35.2)}, "5.2 K warmer"),
        ({"temp_air_c": np.linspace(20.0, 30.0, 90)}, {"temp_air_c": np.full(90, 34.8)}, ""),
        ({"temp_air_c": np.linspace(20.0, 200.0, 90)}, {"temp_air_c": np.full(90, 215.0)}, ""),
        (
            {"temp_ambient_c": np.linspace(20.0, 23.0, 90)},
            {"temp_ambient_c": np.full(90, 14.0)},
            "6 K colder",
        ),
    ],
)
def test_a_test_run_in_another_regime_is_said(
    tmp_path: Path, train: dict[str, object], test: dict[str, object], said: str
) -> None:
    usual = {**ALL_TOLD, "temp_air_c": np.linspace(20.0, 34.0, 90)}
    ran = recorded(tmp_path / "a.csv", **{**usual, **train})
    judges = recorded(tmp_path / "b.csv", **{**usual, **{key: usual[key] for key in train}, **test})
    twin = replace(TWIN, sensor={**TWIN.sensor, "highest_c": 300.0})
    told = [text for text in read_runs([ran], [judges], twin).cannot_tell if "another regime" in text]
    assert (said in told[0]) if said else not told


def test_the_part_before_a_test_run_judges_is_no_regime(tmp_path: Path) -> None:
    air = np.concatenate([np.full(40, 60.0), np.linspace(20.0, 30.0, 50)])
    ran = recorded(tmp_path / "a.csv", **ALL_TOLD, temp_air_c=np.linspace(20.0, 30.0, 90))
    judges = recorded(tmp_path / "b.csv", box_run(2, role="test"), **ALL_TOLD, temp_air_c=air)
    judges.write_text("# validate_from_s: 2400\n" + judges.read_text())
    assert "another regime" not in "\n".join(read(ran, test=[judges]).cannot_tell)


def test_a_lone_run_and_no_test_run_are_said(train: Path) -> None:
    told = "\n".join(read(train).cannot_tell)
    assert "there is one training run" in told
    assert "there is no test run" in told
    assert "not every run says when it began" in told


def test_runs_of_one_day_and_short_runs_are_said(tmp_path: Path) -> None:
    facts = {"start_utc": "2026-07-01T12:00:00Z"}
    path = recorded(tmp_path / "a.csv", replace(box_run(1, rows=60), facts=facts))
    told = "\n".join(read(path).cannot_tell)
    assert "within one day: ua_drift" in told
    assert "no run lasts an hour" in told


# the history


def record(history: Path, *ticks: object) -> None:
    storage = Storage(History.at(history, queue_ticks=1000), HandClock())
    storage.open()
    for one in ticks:
        storage.write(one)  # type: ignore[arg-type]
    assert storage.close(20.0)


def full_tick(seq: int, **values: object):  # type: ignore[no-untyped-def]
    """A tick whose every signal is good."""
    numbers = {"temp_air": 25.0 + 0.1 * seq, "temp_ambient": 21.0, "light": 0.5, "rel_humidity": 55.0}
    readings = {name: Reading(name, value, 0.0, ReadingQuality.GOOD) for name, value in numbers.items()}
    return tick(seq, **{"readings": readings, **values})


@pytest.fixture
def history(tmp_path: Path) -> Path:
    return tmp_path / "history.db"


def test_all_that_effects_need_comes_out_of_the_history(history: Path) -> None:
    record(history, *(full_tick(seq) for seq in range(1, 41)))
    runs = history_runs(export_stretches(history), TWIN)
    run = runs.train[0].run
    assert set(run.columns) >= {*FIVE, "light", "rel_humidity_pct"}
    assert run.columns["light"].tolist() == [0.5] * 32
    assert run.start_utc == START_UTC + 60.0
    # Of 40 rows the newest fifth judges, and begins where the other ends.
    assert [(named.name, len(named.run)) for named in (*runs.train, *runs.test)] == [
        ("history_1", 32),
        ("history_2", 8),
    ]
    assert runs.test[0].run.start_utc == START_UTC + 33 * 60.0


def test_while_safety_overrode_the_command_that_was_sent_is_the_input(history: Path) -> None:
    sent = Command(0.0, fan_on=True, led=0.0)
    overridden = full_tick(
        2, wanted=Command(0.9, False, 0.0), sent=sent, echo=Echo(0.0, True, 0.0, False, False, "", 0.0)
    )
    record(history, full_tick(1), overridden, *(full_tick(seq) for seq in range(3, 41)))
    columns = history_runs(export_stretches(history), TWIN).train[0].run.columns
    assert (columns["heater_duty"][1], columns["fan_on"][1]) == (0.0, 1.0)


def test_a_clock_that_went_back_between_two_sessions_only_separates_them(history: Path) -> None:
    record(history, *(full_tick(seq) for seq in range(1, 31)))
    record(history, *(full_tick(seq, utc=START_UTC - 9e5 + 60.0 * seq) for seq in range(31, 61)))
    runs = history_runs(export_stretches(history), TWIN, test_share=0.0)
    assert [len(named.run) for named in runs.train] == [30, 30]
    assert runs.test == ()


def test_a_sensor_that_was_calibrated_ends_a_stretch_and_an_export_says_when(history: Path) -> None:
    jump = Event("calibration.changed", Severity.INFO, "temp_air is now ...", 0.0, START_UTC)
    other = Event("tick.late", Severity.WARNING, "2 s", 0.0, START_UTC)
    ticks = [full_tick(seq) for seq in range(1, 61)]
    ticks[20] = full_tick(21, events=(other, jump))  # the first tick that reads by it
    ticks[40] = full_tick(41, events=(other,))
    record(history, *ticks)
    stretches = export_stretches(history)
    assert [len(run) for run in stretches] == [20, 40]
    assert all("calibrations" not in run.facts for run in stretches)
    assert export_run(history).facts["calibrations"] == "tick 21: temp_air is now ..."


def test_of_a_long_history_the_newest_rows_are_used_and_the_report_says_since_when(history: Path) -> None:
    first = [full_tick(seq) for seq in range(1, 31)]
    later = [full_tick(31, ticks_skipped=11), *(full_tick(seq) for seq in range(32, 61))]
    record(history, *first, *later)
    runs = history_runs(export_stretches(history), TWIN, test_share=0.25, rows_max=40)
    assert [len(named.run) for named in (*runs.train, *runs.test)] == [10, 20, 10]
    since = datetime.fromtimestamp(START_UTC + 21 * 60.0, UTC).isoformat(timespec="milliseconds")
    assert runs.notes[0].startswith(f"40 of 60 rows of the history are used, from {since} on")
    every = history_runs(export_stretches(history), TWIN, test_share=0.25, rows_max=60)
    assert (sum(len(named.run) for named in every.train), every.notes) == (45, ())


def test_a_named_test_run_of_the_history_is_never_fitted_on(history: Path) -> None:
    record(history, *(full_tick(seq) for seq in range(1, 61)))
    name_run(history, "judge", "test", 11, 20, {"role": "test"})
    runs = history_runs(export_stretches(history), TWIN, test_share=0.0)
    assert [len(named.run) for named in runs.train] == [10, 40]
    assert [named.run.start_utc for named in runs.test] == [START_UTC + 11 * 60.0]
    name_run(history, "all", "test", 1, 60, {"role": "test"})
    with pytest.raises(DataError, match=r"history\.db: only runs of role test"):
        history_runs(export_stretches(history), TWIN, source=str(history))


def test_a_stretch_is_cut_where_the_rig_stood_still(history: Path) -> None:
    first = [full_tick(seq) for seq in range(1, 31)]
    later = [full_tick(31, ticks_skipped=11), *(full_tick(seq) for seq in range(32, 61))]
    record(history, *first, *later)
    runs = history_runs(export_stretches(history), TWIN, test_share=0.0)
    assert [len(named.run) for named in runs.train] == [30, 30]


def test_stretches_that_are_too_short_are_left_out_and_counted() -> None:
    long, short = box_run(1), box_run(2, rows=PIECE_ROWS - 1)
    bare = box_run(3)
    without = replace(bare, columns={k: v for k, v in bare.columns.items() if k != "temp_ambient_c"})
    runs = history_runs([replace(run, facts={}) for run in (long, short, without)], TWIN, test_share=0.0)
    assert [named.name for named in runs.train] == ["history_1", "history_2"]  # one without the room too
    assert runs.notes == ("1 of 3 stretches of the history are too short",)


@pytest.mark.parametrize(
    ("share", "rows"), [(0.0, [90]), (0.2, [72, 18]), (0.02, [88]), (0.6, [36, 54]), (0.7, None)]
)
def test_the_newest_share_of_the_rows_judges(share: float, rows: list[int] | None) -> None:
    stretch = replace(box_run(1), facts={})
    if rows is None:  # 27 rows are too few to fit on
        with pytest.raises(DataError, match="27 usable rows"):
            history_runs([stretch], TWIN, share)
        return
    runs = history_runs([stretch], TWIN, share)
    assert [len(named.run) for named in (*runs.train, *runs.test)] == rows


@pytest.mark.parametrize("share", [-0.1, 1.0, float("nan"), float("inf")])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(DataError, match=r"--test-share: .* is not in 0..1"):
        history_runs([replace(box_run(1), facts={})], TWIN, share)


def test_a_history_without_a_temperature_is_refused() -> None:
    run = box_run(1)
    blind = replace(run, columns={**run.columns, "temp_air_c": np.full(90, np.nan)}, facts={})
    with pytest.raises(DataError, match="the history: no stretch has 5 rows with a temperature"):
        history_runs([blind], TWIN)


# two sensors in the air


def test_the_air_is_the_mean_of_two_sensors_and_how_far_they_are_apart_is_said(tmp_path: Path) -> None:
    run = box_run(1)
    first = run.columns["temp_air_c"].copy()
    duty = np.repeat([0.0, 0.5, 0.0], 30)
    second = first + 0.4 + 2.0 * (duty > 0.0)
    gone = second.copy()
    gone[70], first[71] = np.nan, np.nan
    path = recorded(tmp_path / "a.csv", temp_air_c=first, temp_air_second_c=gone, heater_duty=duty)
    found = read(path)
    air = found.train[0].run.columns["temp_air_c"]
    assert air[:70] == pytest.approx(0.5 * (first + second)[:70])
    assert air[70] == pytest.approx(first[70] + 0.2)
    assert air[71] == pytest.approx(second[71] - 0.2)
    (told,) = found.notes
    assert "0.4 K more than the first in the median, and is 2.4 K from it at most" in told
    assert "2.4 K while the heater is on and 0.4 K while it is off: the air is not mixed" in told


def test_a_second_sensor_that_some_runs_lack_is_passed_over_and_said(tmp_path: Path) -> None:
    air = box_run(1).columns["temp_air_c"]
    one = recorded(tmp_path / "a.csv", temp_air_second_c=air + 3.0)
    other = recorded(tmp_path / "b.csv", box_run(2))
    found = read(one, other)
    assert found.train[0].run.columns["temp_air_c"] == pytest.approx(air)
    assert found.notes == ("temp_air_second_c is not known in every run and is passed over",)


def test_rows_of_an_hour_are_read_where_the_twin_file_says_that_the_house_is_so_slow(tmp_path: Path) -> None:
    run = box_run(1)
    path = recorded(tmp_path / "a.csv", time_s=3600.0 * np.arange(len(run)))
    with pytest.raises(DataError, match="a house that is so slow says so in its twin file: sample_s: 3600"):
        read(path)
    found = read(path, twin=replace(TWIN, sample_s=3600.0))
    assert len(found.train[0].run) == len(run)
