"""`greenhouse twin`: the group, and the free run of `simulate`."""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from history_records import store, tick
from training_runs import BOX, box_run

from edge.__main__ import main
from edge.commands.arguments import moment
from edge.commands.twin_diagnose import add_data_arguments, diagnosis_runs_of
from edge.commands.twin_simulate import START_ROWS, errors, simulate
from edge.core.errors import DataError, RequestError
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.models.pbm import Pbm
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile, write_twin_file
from edge.twin.value import Value

PLAIN = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 20.0}}  # the air is the only state


def twin_file(path: Path, effects: dict[str, dict[str, float]] | None = None) -> Path:
    known = BOX.effects if effects is None else effects
    values = {effect: {name: Value(value) for name, value in own.items()} for effect, own in known.items()}
    write_twin_file(TwinFile(effects=values), path)
    return path


def run_file(path: Path, run: RecordedRun) -> Path:
    write_run(run, path)
    return path


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    return twin_file(tmp_path / "twin.yaml", PLAIN)


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A run that the twin of `twin` has made, without noise."""
    return run_file(tmp_path / "run.csv", box_run(1, box=BoxTwin(effects=PLAIN)))


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Return the one line of a refused action."""
    capsys.readouterr()
    assert main(["twin", *map(str, words)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    return line.removeprefix("greenhouse twin: ")


def test_the_group_knows_its_actions(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["twin", "--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "simulate" in out
    assert "adopt" in out
    with pytest.raises(SystemExit) as ended:
        main(["twin"])
    assert ended.value.code == 2


# simulate


def test_the_twin_that_made_a_run_reproduces_it(
    twin: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.csv"
    assert main(["twin", "simulate", "--twin", str(twin), str(made), "--out", str(out)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[1].split() == [str(out), "80", "0.000", "0.000"]  # 90 rows, 10 of them the start
    back, recorded = read_run(out), read_run(made)
    assert list(back.columns)[:6] == [
        *("time_s", "temp_air_c", "predicted_c", "temp_ambient_c", "heater_duty", "fan_on")
    ]
    assert np.isnan(back.columns["predicted_c"][:START_ROWS]).all()
    assert back.columns["predicted_c"][START_ROWS:] == pytest.approx(
        recorded.columns["temp_air_c"][START_ROWS:], abs=1e-4
    )
    for name in ("temp_air_c", "heater_duty", "fan_on"):
        assert back.columns[name].tolist() == recorded.columns[name].tolist()
    assert back.facts["forecast_from_s"] == "540"
    assert back.facts["twin"] == "twin.yaml"


def test_temperatures_after_the_first_rows_are_not_used() -> None:
    run, pbm = box_run(1), Pbm(BOX)
    nonsense = run.columns["temp_air_c"].copy()
    nonsense[START_ROWS:] = 99.0
    other = replace(run, columns={**run.columns, "temp_air_c": nonsense})
    predicted = [simulate(pbm, one).columns["predicted_c"] for one in (run, other)]
    assert np.array_equal(*predicted, equal_nan=True)


@pytest.mark.parametrize(
    ("known", "start"),
    [(range(90), 9), (range(2), 1), ([0], 0), ([3], 3), ([3, 5], 5), ([3, 12], 12), ([3, 13], 3), ([89], 89)],
)
def test_a_run_starts_at_the_last_temperature_of_its_first_ten_rows(known: range, start: int) -> None:
    run = box_run(1)
    temps = np.full(90, np.nan)
    temps[list(known)] = run.columns["temp_air_c"][list(known)]
    simulated = simulate(Pbm(BOX), replace(run, columns={**run.columns, "temp_air_c": temps}))
    predicted = simulated.columns["predicted_c"]
    assert np.isnan(predicted[: start + 1]).all()
    assert np.isfinite(predicted[start + 1 :]).all()
    assert simulated.facts["forecast_from_s"] == f"{60 * start}"


def test_holes_in_the_room_temperature_are_held_over() -> None:
    run = box_run(1)
    room = run.columns["temp_ambient_c"].copy()
    room[[0, 30, 31, 89]] = np.nan
    simulated = simulate(Pbm(BOX), replace(run, columns={**run.columns, "temp_ambient_c": room}))
    assert np.isfinite(simulated.columns["predicted_c"][START_ROWS:]).all()


def test_errors_are_of_what_was_forecast_and_measured() -> None:
    columns = {
        "temp_air_c": np.array([20.0, 21.0, np.nan, 24.0]),
        "predicted_c": np.array([np.nan, 22.0, 23.0, 21.0]),
    }
    found = errors(RecordedRun({"time_s": 60.0 * np.arange(4), **columns}))
    assert (found.rows, found.mae_k) == (2, 2.0)  # 1 K and 3 K
    assert found.rmse_k == pytest.approx(5.0**0.5)


def test_a_test_run_that_hides_its_temperatures_is_forecast_all_the_same(
    twin: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = box_run(1, role="test")
    run.columns["temp_air_c"][2:] = np.nan
    path = run_file(tmp_path / "test.csv", run)
    assert main(["twin", "simulate", "--twin", str(twin), str(path)]) == 0
    told = capsys.readouterr()
    assert told.out.splitlines()[0] == "# role: test"
    assert len([line for line in told.out.splitlines() if not line.startswith("#")]) == 91
    assert "nothing to compare with" in told.err  # figures are no part of the CSV


def test_several_runs_go_into_a_folder_at_the_twins_step(
    twin: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine = box_run(2)
    paths = [
        run_file(tmp_path / "a.csv", box_run(1)),
        run_file(tmp_path / "b.csv", replace(fine, columns={**fine.columns, "time_s": 30.0 * np.arange(90)})),
    ]
    out = tmp_path / "deep" / "out"
    assert main(["twin", "simulate", "--twin", str(twin), *map(str, paths), "--out", str(out)]) == 0
    assert [len(read_run(out / name)) for name in ("a.csv", "b.csv")] == [90, 45]
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_what_a_run_does_not_say_is_asked_for_and_can_be_said(
    twin: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = box_run(1, box=BoxTwin(effects=PLAIN))
    bare = {name: run.columns[name] for name in ("time_s", "temp_air_c", "heater_duty")}
    path = run_file(tmp_path / "bare.csv", RecordedRun(bare))
    words = ["simulate", "--twin", twin, path]
    assert "fan_on is not among the columns" in refusal(capsys, *words)
    assert (
        refusal(capsys, *words, "--no-fan")
        == f"{path}: temp_ambient_c: not known; say what it was with --ambient-c"
    )
    out = tmp_path / "out.csv"
    for options, fan in ((["--no-fan"], 0.0), (["--fan-always-on"], 1.0)):
        said = [*words, "--ambient-c", "21.5", "--out", out, *options]
        assert main(["twin", *map(str, said)]) == 0
        columns = read_run(out).columns
        assert (set(columns["temp_ambient_c"]), set(columns["fan_on"])) == ({21.5}, {fan})


def test_no_recording_is_overwritten(
    twin: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = made.read_bytes()
    for out in (made, made.parent):
        line = refusal(capsys, "simulate", "--twin", twin, made, "--out", out)
        assert line == f"--out: {made} is a recorded run and is not overwritten"
    assert made.read_bytes() == before
    (tmp_path / "other").mkdir()
    twice = run_file(tmp_path / "other" / "run.csv", box_run(2))
    assert "two runs have one name" in refusal(
        capsys, "simulate", "--twin", twin, made, twice, "--out", tmp_path / "o"
    )
    assert "several runs need a folder" in refusal(capsys, "simulate", "--twin", twin, made, twice)


def test_a_twin_file_that_is_wrong_is_named_with_its_key(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("effects: {wall_loss: {UA: {fit: true}}}")
    line = refusal(capsys, "simulate", "--twin", path, made)
    assert line.startswith(f"{path}: effects.wall_loss.UA: is still to be fitted")


@pytest.mark.parametrize(
    ("column", "change", "message"),
    [
        ("temp_air_c", 273.15, "line 4: temp_air_c: 295.15 is not a plausible air temperature in degC"),
        ("temp_air_c", np.nan, "temp_air_c: nothing was measured to start from"),
        ("temp_ambient_c", np.nan, "temp_ambient_c: not known"),
    ],
)
def test_a_run_that_is_wrong_is_named_with_its_column(
    twin: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, change: float, message: str
) -> None:
    run = box_run(1)  # facts stand in lines 1 and 2, the header in 3
    path = run_file(
        tmp_path / "r.csv", replace(run, columns={**run.columns, column: run.columns[column] + change})
    )
    assert refusal(capsys, "simulate", "--twin", twin, path).startswith(f"{path}: {message}")


def test_a_column_that_an_effect_needs_is_named(made: Path, tmp_path: Path) -> None:
    lit = BoxTwin(effects={**PLAIN, "led_gain": {"P_led": 20.0}})
    with pytest.raises(DataError, match=r"run\.csv: light: missing, the twin's led_gain needs this column"):
        simulate(Pbm(lit), read_run(made))


def test_light_and_time_of_day_reach_the_twin() -> None:
    lit = BoxTwin(effects={**PLAIN, "led_gain": {"P_led": 20.0}})
    run = box_run(1)
    run.columns["fan_on"][:] = 0.0
    dark, bright = (
        simulate(Pbm(lit), replace(run, columns={**run.columns, "light": np.full(90, level)})).columns
        for level in (0.0, 1.0)
    )
    # 20 W over 4 W/K are 5 K at rest; air of 20 * 0.15 m³ * 1.2 * 1005 = 3618 J/K gets there in 904 s (1/e).
    warmer = 5.0 * (1.0 - np.exp(-51 * 60.0 * 4.0 / 3618.0))
    assert (bright["predicted_c"] - dark["predicted_c"])[60] == pytest.approx(warmer, abs=2e-4)
    ageing = BoxTwin(effects={**PLAIN, "ua_drift": {"ua_drift": 0.1}}, day0_utc=0.0)
    young, old = (
        simulate(Pbm(ageing), replace(run, facts={"start_utc": start})).columns["predicted_c"][-1]
        for start in ("1970-01-01T00:00:00Z", "1970-01-11T00:00:00Z")
    )
    assert abs(young - old) > 0.1  # ten days later the walls let out twice as much


# which recordings


def data(*words: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_data_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def test_run_files_are_named_before_and_after_test(made: Path, tmp_path: Path) -> None:
    test = run_file(tmp_path / "test.csv", box_run(2, role="test"))
    runs = diagnosis_runs_of(data(made, "--test", test), TwinFile())
    assert ([named.name for named in runs.train], [named.name for named in runs.test]) == (
        ["run.csv"],
        ["test.csv"],
    )


def test_the_history_is_taken_by_its_age(tmp_path: Path) -> None:
    history = tmp_path / "history.db"
    now = time.time()  # of the newest; the oldest is 99 minutes older
    store(history, *(tick(seq, utc=now - 60.0 * (100 - seq)) for seq in range(1, 101)))
    runs = diagnosis_runs_of(data("--history", history, "--since", "1h", "--test-share", "0.5"), TwinFile())
    assert [len(named.run) for named in (*runs.train, *runs.test)] == [31, 30]  # both ends count
    with pytest.raises(DataError, match="no ticks in this stretch"):
        diagnosis_runs_of(data("--history", history, "--until", "2d"), TwinFile())


def test_files_and_history_are_not_mixed_and_nothing_is_refused(made: Path) -> None:
    with pytest.raises(RequestError, match="run files and the history don't go together"):
        diagnosis_runs_of(data(made, "--since", "14d"), TwinFile())
    with pytest.raises(RequestError, match="nothing to diagnose: give run files"):
        diagnosis_runs_of(data(), TwinFile())


@pytest.mark.parametrize(
    ("text", "utc"),
    [
        (None, None),
        ("14d", 1e9 - 14 * 86400.0),
        ("1.5h", 1e9 - 5400.0),
        ("90min", 1e9 - 5400.0),
        ("0d", 1e9),
        ("1970-01-01T01:00", 3600.0),
        ("1970-01-01T01:00+01:00", 0.0),
    ],
)
def test_a_time_is_an_instant_or_an_age(text: str | None, utc: float | None) -> None:
    assert moment(text, now_utc=1e9) == utc


@pytest.mark.parametrize("text", ["", "14", "d", "-1d", "1e3d", "nand", "14 d", "14w", "noon"])
def test_what_is_neither_is_refused(text: str) -> None:
    with pytest.raises(RequestError, match=r"is no time like .* and no age like 14d"):
        moment(text)
