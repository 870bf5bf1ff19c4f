"""Run files and runs in the history."""

import math
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from history_records import START_UTC, HandClock, History, eventful_tick, store, tick
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edge.core.errors import DataError
from edge.core.messages import Reading, ReadingQuality
from edge.formats.run_file import (
    OPTION_WITHOUT,
    RecordedRun,
    absence_facts,
    period,
    read_run,
    resample,
    write_run,
)
from edge.storage import Outbox, Storage
from edge.storage.runs import events_between, export_run, import_run, name_run

pytestmark = pytest.mark.slow

NAN = math.nan
HEADER = "time_s,temp_air_c,temp_ambient_c,heater_duty,fan_on\n"
SHARED = Path(__file__).parents[4] / "shared" / "data"
RUN_FILES = ("heated_box", "tclab")  # the others lie there in the form of their owners
LOGS = [
    Path(__file__).parents[2] / "data" / "made_irregular_run.csv",
    *(path for name in RUN_FILES for path in sorted((SHARED / name).glob("*.csv"))),
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.csv"


def read(path: Path, text: str) -> RecordedRun:
    path.write_text(text, encoding="utf-8")
    return read_run(path)


def same(left: RecordedRun, right: RecordedRun) -> bool:
    return (
        list(left.columns) == list(right.columns)
        and left.facts == right.facts
        and all(np.array_equal(left.columns[key], right.columns[key], equal_nan=True) for key in left.columns)
    )


# reading


def test_columns_facts_and_missing_cells_are_read(path: Path) -> None:
    text = (
        "# start_utc: 2026-07-01T12:00:00Z\n# notes: door open: twice\n"
        + HEADER
        + "0,21.5,20,0.5,0\n60,,20,1,1\n"
    )
    run = read(path, text)
    assert run.columns["temp_air_c"][0] == 21.5
    assert math.isnan(run.columns["temp_air_c"][1])
    assert list(run.columns["heater_duty"]) == [0.5, 1.0]
    assert run.facts == {"start_utc": "2026-07-01T12:00:00Z", "notes": "door open: twice"}
    assert run.start_utc == 1782907200.0  # date -u -d 2026-07-01T12:00:00Z +%s
    assert len(run) == 2


def test_ambient_and_fan_may_be_absent_where_that_is_said_and_unknown_columns_are_kept(path: Path) -> None:
    text = "time_s,temp_air_c,heater_duty,fan_rpm,heater_2_duty,temp_2_c\n0,20,0,2750,1,30\n"
    path.write_text(text)
    run = read_run(path, OPTION_WITHOUT)
    assert list(run.columns) == text.splitlines()[0].split(",")
    run = read(
        path, "# fan_on: none\n# temp_ambient_c: none\ntime_s,temp_air_c,heater_duty,fan_rpm\n0,20,0,2750\n"
    )
    assert list(run.columns) == ["time_s", "temp_air_c", "heater_duty", "fan_rpm"]
    assert run.start_utc is None


@pytest.mark.parametrize(
    "start", ["2026-07-01T12:00:00", "2026-07-01T14:00:00+02:00", "2026-07-01 12:00:00Z"]
)
def test_a_start_is_utc_unless_it_says_otherwise(path: Path, start: str) -> None:
    assert read(path, f"# start_utc: {start}\n{HEADER}0,20,20,0,0\n").start_utc == 1782907200.0


def test_a_mark_of_unicode_and_carriage_returns_are_no_matter(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbf# rig: a\r\n" + HEADER.strip().encode() + b"\r\n0,20,20,0,0\r\n\r\n")
    assert len(read_run(path)) == 1
    assert read_run(path).facts == {"rig": "a"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there is no header"),
        ("# rig: a\n", "there is no header"),
        (HEADER, "there are no rows"),
        ("# role: test\n# role: train\n" + HEADER + "0,20,20,0,0\n", "line 2: role stands there twice"),
        ("# no colon\n" + HEADER + "0,20,20,0,0\n", "line 1: '# no colon' is no `# key: value`"),
        ("temp_air_c,heater_duty\n20,0\n", "line 1: time_s is not among the columns"),
        ("time_s,heater_duty\n0,0\n", "temp_air_c is not among the columns"),
        ("time_s,temp_air_c,temp_ambient_c\n0,20,20\n", "heater_duty is not among the columns"),
        (
            HEADER.replace(",temp_ambient_c", "") + "0,20,0,0\n",
            "say so: --no-ambient, or the line '# temp_am",
        ),
        (HEADER.replace(",fan_on", "") + "0,20,20,0\n", "say so: --no-fan, or the line '# fan_on: none'"),
        ("# fan_on: none\n" + HEADER + "0,20,20,0,0\n", "the fact says 'none', but the column is there"),
        ("# fan_on: off\n" + HEADER + "0,20,20,0,0\n", "'off': this fact can only be 'none'"),
        ("time_s;temp_air_c;heater_duty\n0;20;0\n", "time_s is not among the columns"),
        ("time_s,temp_air_c,temp_air_c,heater_duty\n0,1,1,0\n", "'temp_air_c' is no name for one column"),
        ("time_s,temp_air_c,,heater_duty\n0,1,1,0\n", "'' is no name for one column"),
        (HEADER + "0,20,20,0\n", "line 2: 4 cells, the header has 5"),
        (HEADER + "0,20,20,0,0,0\n", "line 2: 6 cells"),
        (HEADER + "0,20,20,0,0\n60,warm,20,0,0\n", "line 3: temp_air_c: 'warm' is no number"),
        (HEADER + "0,nan,20,0,0\n", "line 2: temp_air_c: 'nan' is no number"),
        (HEADER + "0,inf,20,0,0\n", "temp_air_c: 'inf' is no number"),
        (HEADER + "0,1_0,20,0,0\n", "temp_air_c: '1_0' is no number"),
        (HEADER + '0,"20,5",20,0,0\n', "temp_air_c: '20,5' is no number"),
        (HEADER + "0,1e999,20,0,0\n", "temp_air_c: '1e999' is no number"),
        (HEADER + "0,1e308,20,0,0\n", "temp_air_c: '1e308' is no number of at most 1e"),
        (HEADER + "1,20,20,0,0\n", "line 2: time_s: 1 must be 0 in the first row"),
        (HEADER + "0,20,20,0,0\n,20,20,0,0\n", "line 3: time_s: empty is no time"),
        (HEADER + "0,20,20,0,0\n60,20,20,0,0\n59,20,20,0,0\n", "line 4: time_s: 59 does not come after"),
        (HEADER + "0,20,20,0,0\n\n0,20,20,0,0\n", "line 4: time_s: 0 does not come after"),
        (HEADER + "0,20,20,1.01,0\n", "line 2: heater_duty: 1.01 is not in 0..1"),
        (HEADER + "0,20,20,-0.01,0\n", "line 2: heater_duty: -0.01 is not in 0..1"),
        (HEADER + "0,20,20,0,2\n", "line 2: fan_on: 2 is not in 0..1"),
        (HEADER + "0,20,20,,0\n", "line 2: heater_duty: empty is unknown; an input must be known"),
        ("# start_utc: noon\n" + HEADER + "0,20,20,0,0\n", "start_utc: 'noon' is no time"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError) as error:
        read(path, text)
    assert str(error.value).startswith(str(path))
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("fan", "fan_on"),
        ("FanOn", "fan_on"),
        ("fan on", "fan_on"),
        ("temp_ambient", "temp_ambient_c"),
        ("temp_room_c", "temp_ambient_c"),
        ("temp_ambeint_c", "temp_ambient_c"),
        ("temp", "temp_air_c or temp_ambient_c or temp_air_second_c"),
        ("heater", "heater_duty"),
        ("heater_dtuy", "heater_duty"),
        ("lihgt", "light"),
        ("rel_humidty_pct", "rel_humidity_pct or ambient_rel_humidity_pct"),
        ("co2", "co2_ppm"),
    ],
)
def test_a_name_near_a_known_one_is_refused_with_that_name(path: Path, name: str, meant: str) -> None:
    path.write_text(f"time_s,{name}\n0,0\n")
    with pytest.raises(DataError, match=f"unknown column '{name}': is it {re.escape(meant)}\\?"):
        read_run(path, OPTION_WITHOUT)  # no option makes a slip of the pen another column


@pytest.mark.parametrize(
    "name", ["fan_rpm", "fan_2_on", "heater_2_duty", "temp_2_c", "temp_plate_c", "predicted_c", "window", "t"]
)
def test_a_name_unlike_the_known_ones_is_kept(path: Path, name: str) -> None:
    run = read(path, HEADER.replace("\n", f",{name}\n") + "0,20,20,0,0,7\n")
    assert list(run.columns[name]) == [7.0]


def test_a_name_near_one_that_is_there_is_another_column(path: Path) -> None:
    assert list(read(path, HEADER.replace("\n", ",fan\n") + "0,20,20,0,1,0\n").columns["fan_on"]) == [1.0]


def test_a_written_run_says_which_columns_it_lacks(path: Path) -> None:
    lacking = run_of(time_s=[0, 1], temp_air_c=[20, 21])
    write_run(absence_facts(lacking), path)
    assert read_run(path).facts == {"fan_on": "none", "temp_ambient_c": "none"}
    assert absence_facts(read(path, HEADER + "0,20,20,0,0\n")).facts == {}


def test_a_missing_file_and_bytes_that_are_no_text_are_data_errors(path: Path) -> None:
    with pytest.raises(DataError, match=r"run\.csv"):
        read_run(path)
    path.write_bytes(b"\xff\xfe\x00time_s")
    with pytest.raises(DataError, match=r"run\.csv"):
        read_run(path)


@pytest.mark.parametrize("duty", ["0", "1", "0.0000", "1.0", ".5", "1.", "5e-1", "+1"])
def test_edges_and_spellings_of_a_duty(path: Path, duty: str) -> None:
    assert read(path, HEADER + f"0,20,20,{duty},0\n").columns["heater_duty"][0] == float(duty)


# writing

numbers = st.floats(-1e9, 1e9) | st.just(math.nan)
shares = st.floats(0.0, 1.0)
fact_texts = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1)


@st.composite
def runs(draw: st.DrawFn) -> RecordedRun:
    steps = draw(st.lists(st.floats(1e-3, 1e5), min_size=0, max_size=12))
    rows = len(steps) + 1

    def column(values: st.SearchStrategy[float]) -> np.ndarray:
        return np.array(draw(st.lists(values, min_size=rows, max_size=rows)))

    columns = {
        "time_s": np.concatenate(([0.0], np.cumsum(steps))),
        "temp_air_c": column(numbers),
        "heater_duty": column(shares),
        "fan_on": column(shares),
        "temp_plate_c": column(numbers),
    }
    facts = draw(st.dictionaries(fact_texts.filter(lambda key: ":" not in key), fact_texts, max_size=3))
    facts.pop("start_utc", None)
    return RecordedRun(columns, facts)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(run=runs())
def test_what_is_written_reads_back_the_same(path: Path, run: RecordedRun) -> None:
    write_run(run, path)
    assert same(read_run(path, OPTION_WITHOUT), run)


@pytest.mark.parametrize("facts", [{"a:b": "c"}, {"": "c"}, {"a": "b\nc"}, {" a": "c"}, {"a": "c "}])
def test_a_fact_that_would_not_read_back_is_not_written(path: Path, facts: dict[str, str]) -> None:
    with pytest.raises(DataError):
        write_run(RecordedRun({"time_s": np.zeros(1)}, facts), path)
    assert not path.exists()


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(st.sampled_from("#:,.0123456789-e\n\r\"' time_sairc")))
def test_any_text_is_read_or_refused_and_nothing_else(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="")
    try:
        assert len(read_run(path)) > 0
    except DataError as error:
        assert str(error).startswith(str(path))


# one period


def run_of(**columns: list[float]) -> RecordedRun:
    arrays = {key: np.array(values, dtype=float) for key, values in columns.items()}
    if "heater_duty" not in arrays:
        arrays["heater_duty"] = np.zeros(len(arrays["time_s"]))
    return RecordedRun(arrays)


@pytest.mark.parametrize(("times", "step_s"), [([0, 60], 60.0), ([0, 1.001, 1.999, 3.0], 1.0)])
def test_the_period_of_regular_rows(times: list[float], step_s: float) -> None:
    assert period(run_of(time_s=times)) == pytest.approx(step_s)


@pytest.mark.parametrize("times", [[0.0], [0, 60, 180], [0, 1, 2.02, 3]])
def test_irregular_rows_have_no_period(times: list[float]) -> None:
    with pytest.raises(DataError):
        period(run_of(time_s=times))


def test_a_run_that_has_just_these_rows_is_left_as_it_is() -> None:
    run = run_of(time_s=[0, 60, 120], temp_air_c=[20, math.nan, 22], heater_duty=[0.1, 0.2, 0.3])
    assert same(resample(run, 60.0), run)


@pytest.mark.parametrize(
    ("times", "step_s", "key", "values", "expected"),
    [
        # Inputs: means over a longer period, so that no heat is lost; else they hold until the next row.
        ([0, 1, 2, 3, 4, 5], 2.0, "heater_duty", [1, 0, 0, 0, 1, 1], [0.5, 0.0, 1.0]),
        ([0, 1, 2, 3, 4, 5], 2.0, "fan_on", [0, 1, 1, 1, 1, 1], [0.5, 1.0, 1.0]),
        ([0, 3, 6], 1.0, "heater_duty", [0.2, 0.8, 0.4], [0.2, 0.2, 0.2, 0.8, 0.8, 0.8, 0.4]),
        ([0, 3, 6], 1.0, "heater_2_duty", [1, 0, 1], [1, 1, 1, 0, 0, 0, 1]),
        # Readings: interpolated, but not between far ones, before the first or after the last.
        ([0, 3, 6], 2.0, "temp_air_c", [20, 23, 20], [20, 22, 22, 20]),
        ([0, 1, 2, 9, 10], 1.0, "temp_air_c", [20, 20, 20, 27, 28], [20] * 3 + [NAN] * 6 + [27, 28]),
        ([0, 2, 4, 6], 1.0, "temp_air_c", [NAN, 20, 20, NAN], [NAN, NAN, 20, 20, 20, NAN, NAN]),
        ([0, 3], 1.0, "temp_air_c", [NAN, NAN], [NAN] * 4),
        ([0, 1, 2, 3, 4, 5], 2.0, "light", [1, NAN, 1, 1, 0, 0], [NAN, 1, 0]),  # does not spread
    ],
)
def test_columns_at_new_instants(
    times: list[float], step_s: float, key: str, values: list[float], expected: list[float]
) -> None:
    found = resample(run_of(time_s=times, **{key: values}), step_s).columns[key]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("step_s", [0.0, -1.0, math.nan])
def test_a_period_that_is_none_is_refused(step_s: float) -> None:
    with pytest.raises(DataError):
        resample(run_of(time_s=[0, 1]), step_s)


@settings(max_examples=100, deadline=None)
@given(run=runs(), step_s=st.floats(0.5, 1e4))
def test_resampling_keeps_every_value_within_its_old_range(run: RecordedRun, step_s: float) -> None:
    if run.columns["time_s"][-1] / step_s > 1e5:
        return
    new = resample(run, step_s)
    for key in ("temp_air_c", "heater_duty"):
        old = run.columns[key][~np.isnan(run.columns[key])]
        values = new.columns[key][~np.isnan(new.columns[key])]
        if len(values):
            slack = 1e-6 * max(1.0, np.abs(old).max())
            assert old.min() - slack <= values.min() and values.max() <= old.max() + slack
    if len(new) > 1:
        assert period(new) == pytest.approx(step_s)


@pytest.mark.parametrize("measured", LOGS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_measured_logs_are_read_and_brought_to_one_period(measured: Path) -> None:
    run = read_run(measured, OPTION_WITHOUT)
    new = resample(run, 10.0)
    assert period(new) == 10.0
    assert list(new.columns) == list(run.columns)
    assert not np.isnan(new.columns["temp_air_c"]).any()
    # The heat: within one step, which the last row may or may not fill.
    held = np.append(np.diff(run.columns["time_s"]), 0.0)
    assert new.columns["heater_duty"].sum() * 10.0 == pytest.approx(
        (run.columns["heater_duty"] * held).sum(), abs=10.0
    )


# the history


@pytest.fixture
def history(tmp_path: Path) -> Path:
    return tmp_path / "history.db"


def test_a_stretch_of_history_is_a_run_file(history: Path, path: Path) -> None:
    store(history, *(tick(seq) for seq in range(1, 6)))
    write_run(export_run(history, first_seq=2, last_seq=4), path)
    run = read_run(path)
    assert list(run.columns)[:5] == ["time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on"]
    assert list(run.columns["time_s"]) == [0.0, 60.0, 120.0]
    assert list(run.columns["temp_air_c"]) == [25.2, 25.3, 25.4]
    assert list(run.columns["fan_on"]) == [0.0, 1.0, 0.0]
    assert list(run.columns["reference_c"]) == [26.0] * 3
    assert "co2_ppm" not in run.columns  # that sensor is absent
    assert run.start_utc == START_UTC + 120.0
    assert run.facts["first_seq"] == "2"


def test_a_stretch_by_wall_clock_includes_both_ends(history: Path) -> None:
    store(history, *(tick(seq) for seq in range(1, 6)))
    run = export_run(history, since_utc=START_UTC + 120.0, until_utc=START_UTC + 240.0)
    assert len(run) == 3


def test_bad_readings_are_missing_and_unconfirmed_commands_are_off(history: Path) -> None:
    store(
        history,
        tick(1),
        eventful_tick(2),
        tick(3, readings={"temp_air": Reading("temp_air", 80.0, 0.0, ReadingQuality.SPIKE)}),
    )
    run = export_run(history)
    assert list(np.isnan(run.columns["temp_air_c"])) == [False, True, True]
    assert run.columns["heater_duty"][1] == 0.0


def test_time_follows_the_grid_whatever_the_wall_clock_does(history: Path) -> None:
    store(
        history,
        tick(1, utc=START_UTC),
        tick(2, utc=START_UTC + 1e6),
        tick(3, utc=START_UTC - 1e6, ticks_skipped=2),
        tick(5, utc=START_UTC),  # tick 4 was lost
    )
    assert list(export_run(history).columns["time_s"]) == [0.0, 60.0, 240.0, 360.0]


def test_between_sessions_the_wall_clock_counts(history: Path) -> None:
    store(history, tick(1, utc=START_UTC))
    store(history, tick(2, utc=START_UTC + 1000.0))
    assert list(export_run(history).columns["time_s"]) == [0.0, 1000.0]
    store(history, tick(3, utc=START_UTC))
    with pytest.raises(DataError, match="tick 3: the wall clock went back"):
        export_run(history)


def test_a_run_goes_into_the_history_and_comes_back_the_same(history: Path) -> None:
    run = RecordedRun(
        {
            "time_s": np.array([0.0, 1.001, 2.5]),
            "temp_air_c": np.array([20.0, math.nan, 21.0]),
            "heater_duty": np.array([0.0, 0.9091, 1.0]),
            "fan_rpm": np.array([2750.0, 4915.0, math.nan]),
        },
        {"start_utc": "2022-03-12T19:59:43Z", "role": "train", "notes": "a box"},
    )
    assert import_run(history, run, "box") == (-3, -1)
    assert same(export_run(history, name="box"), run)
    assert import_run(history, replace(run, facts={}), "again") == (-6, -4)
    assert same(export_run(history, name="again"), replace(run, facts={}))
    with pytest.raises(DataError, match="there is a run 'box' already"):
        import_run(history, run, "box")
    with closing(sqlite3.connect(history)) as connection:
        assert connection.execute("SELECT count(*) FROM ticks").fetchone() == (6,)
        # What the file does not say is unknown, not off.
        assert connection.execute("SELECT DISTINCT fan_on FROM v_ticks").fetchall() == [(None,)]


def test_an_import_does_not_disturb_the_daemon(history: Path) -> None:
    storage = Storage(History.at(history), HandClock())
    first = storage.open()
    storage.write(tick(first))
    import_run(history, run_of(time_s=[0, 1], temp_air_c=[20, 21]), "box")
    storage.write(tick(first + 1))
    assert storage.close(20.0)
    assert storage.lost_ticks == 0
    with closing(Outbox(history, "g")) as outbox:
        assert outbox.depth() == 2
        assert outbox.resend(-10, 10) == 2
    assert len(export_run(history)) == 2
    storage = Storage(History.at(history), HandClock())
    assert storage.open() == first + 2
    storage.close(20.0)


def test_a_named_stretch_is_exported_with_its_facts(history: Path) -> None:
    store(history, *(tick(seq) for seq in range(1, 6)))
    name_run(history, "steps", "train", 2, 3, {"role": "train"})
    run = export_run(history, name="steps")
    assert len(run) == 2
    assert run.facts["role"] == "train"
    assert run.facts["controllers"] == "MPC-P"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "other"}, "there is no run 'other'"),
        ({"first_seq": 9}, "there are no ticks in this stretch"),
    ],
)
def test_a_stretch_that_is_not_there_is_refused(
    history: Path, arguments: dict[str, object], message: str
) -> None:
    store(history, tick(1))
    with pytest.raises(DataError, match=message):
        export_run(history, **arguments)


def test_a_view_in_a_tables_place_is_refused_its_query_may_have_no_end(history: Path) -> None:
    store(history, tick(1))
    with closing(sqlite3.connect(history)) as connection:
        connection.executescript("PRAGMA legacy_alter_table = ON; ALTER TABLE ticks RENAME TO hidden;")
        connection.execute("CREATE VIEW ticks AS SELECT * FROM hidden")
    with pytest.raises(DataError, match=r"history\.db: ticks is a view"):
        export_run(history)


def test_a_damaged_letter_in_the_history_is_one_letter(history: Path) -> None:
    store(history, tick(1))
    with closing(sqlite3.connect(history)) as connection, connection:
        connection.execute("UPDATE ticks SET controller = CAST(X'4dd143' AS TEXT)")
    assert export_run(history).facts["controllers"] == "M\ufffdC"


def test_exporting_makes_no_history(history: Path) -> None:
    with pytest.raises(DataError, match=r"history\.db"):
        export_run(history)
    with pytest.raises(DataError, match="there is no history"):
        name_run(history, "a", "", 1, 2, {})
    assert not history.exists()


def test_events_are_found_by_their_time(history: Path) -> None:
    store(history, eventful_tick(1))
    assert [event.key for event in events_between(history, START_UTC, START_UTC)] == ["board.link_lost"]
    assert len(events_between(history, START_UTC, START_UTC + 1.0)) == 2
