"""The thin commands: what they write, and one clear line with exit code 2 for what is wrong."""

import json
import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import COMMANDS, main
from edge.commands.orders import ORDERS
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.models.arx_file import read_arx

START = "2026-07-01T12:00:00Z"
BAD_CSV = "time_s,heater_duty,fan_on\n0,2,0\n"


def run_file(folder: Path, name: str = "run.csv", rows: int = 120, seed: int = 1) -> Path:
    """A run of a first-order box with random steps in both inputs."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.integers(0, 21, rows // 4 + 1) / 20, 4)[:rows]
    fan = np.repeat(rng.integers(0, 2, rows // 6 + 1), 6)[:rows].astype(float)
    ambient = 21.0 + 0.1 * np.sin(np.arange(rows) / 9.0)
    temp = np.full(rows, 21.0)
    for k in range(rows - 1):
        temp[k + 1] = 0.9 * temp[k] + 2.0 * heater[k] - 0.5 * fan[k] + 0.1 * ambient[k]
    columns = {"time_s": 60.0 * np.arange(rows), "temp_air_c": temp, "temp_ambient_c": ambient}
    write_run(
        RecordedRun({**columns, "heater_duty": heater, "fan_on": fan}, {"start_utc": START, "role": "train"}),
        folder / name,
    )
    return folder / name


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line on standard error of a command that ends with exit code 2."""
    assert main([str(word) for word in words]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"greenhouse {words[0]}: ")
    return lines[0]


@pytest.mark.parametrize("command", [*COMMANDS, *ORDERS])
def test_every_command_has_help(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"greenhouse {command}" in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["fly"], ["experiment"], ["fit-arx", "--train", "a.csv"], ["plot"]])
def test_wrong_arguments_end_with_code_2_and_the_usage(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert "usage: greenhouse" in capsys.readouterr().err


# import, export


def test_a_run_goes_into_the_history_and_comes_out_the_same(tmp_path):
    source, database = run_file(tmp_path), tmp_path / "h.db"
    assert main(["import", str(source), "--history", str(database)]) == 0
    words = ["export", "--history", str(database), "--run", "run", "--out", str(tmp_path / "out.csv")]
    assert main(words) == 0
    before, after = read_run(source), read_run(tmp_path / "out.csv")
    for key, values in before.columns.items():
        np.testing.assert_array_equal(after.columns[key], values)
    assert after.facts["role"] == "train"


def test_export_takes_what_lies_within_the_bounds(tmp_path):
    database = ticks_in_history(tmp_path)
    out = tmp_path / "out.csv"
    words = ["--since", "2026-07-01T12:10", "--until", "2026-07-01T14:30+02:00", "--out", str(out)]
    assert main(["export", "--history", str(database), *words]) == 0
    assert len(read_run(out)) == 21
    assert read_run(out).facts["start_utc"].startswith("2026-07-01T12:10")


def ticks_in_history(folder: Path) -> Path:
    """A history whose ticks are numbered as a daemon's are."""
    database = folder / "h.db"
    main(["import", str(run_file(folder)), "--history", str(database)])
    with sqlite3.connect(database) as connection:
        for table in ("ticks", "readings"):
            connection.execute(f"UPDATE {table} SET seq = seq + 1000")
    connection.close()
    return database


def test_a_run_is_not_imported_twice_under_one_name(tmp_path, capsys):
    words = ["import", run_file(tmp_path), "--history", tmp_path / "h.db"]
    assert main([str(word) for word in words]) == 0
    capsys.readouterr()
    assert "there is a run 'run' already" in refusal(capsys, *words)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--history", "none.db"], "none.db: unable to open"),
        (["--history", "h.db", "--run", "walk"], "there is no run 'walk'; known are ['run']"),
        (["--history", "h.db", "--since", "2030-01-01"], "there are no ticks in this stretch"),
        (["--history", "h.db", "--since", "noon"], "'noon' is no time like"),
        (["--history", "run.csv"], "run.csv: file is not a database"),
        (["--history", "h.db", "--run", "run", "--out", "none/out.csv"], "none/out.csv: can't be written"),
    ],
)
def test_what_cannot_be_exported_is_told_in_one_line(tmp_path, monkeypatch, capsys, words, reason):
    monkeypatch.chdir(tmp_path)
    main(["import", str(run_file(tmp_path)), "--history", "h.db"])
    capsys.readouterr()
    assert reason in refusal(capsys, "export", "--out", "out.csv", *words)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "No such file"),
        (
            "# fan_on: none\n# temp_ambient_c: none\ntime_s,temp_air_c,heater_duty\n0,20,1.5\n",
            "line 4: heater_duty: 1.5 is not in 0..1",
        ),
    ],
)
def test_a_wrong_run_file_is_told_with_its_place(tmp_path, capsys, text, reason):
    path = tmp_path / "bad.csv"
    if text is not None:
        path.write_text(text)
    for words in (
        ["import", path, "--history", tmp_path / "h.db"],
        ["plot", path, "--out", tmp_path / "p.png"],
        ["fit-arx", "--train", path, "--validate", path, "--out", tmp_path / "m.json"],
    ):
        line = refusal(capsys, *words)
        assert str(path) in line and reason in line


@pytest.mark.parametrize(
    "words",
    [
        "import RUN --history h.db",
        "import RUN --history h.db --no-fan",
        "plot RUN --out p.png",
        "fit-arx --train RUN --validate RUN --out m.json --fan none",
        "replay RUN --fan-always-on",
        "twin simulate RUN --twin TWIN",
        "twin diagnose RUN --twin TWIN --out report",
        "twin diagnose RUN --twin TWIN --out report --no-fan",
    ],
)
def test_a_column_fan_is_not_taken_for_a_fan_that_never_runs(tmp_path, monkeypatch, capsys, words):
    # `fan` for `fan_on` once made a diagnosis name a wrong effect and propose to adopt it.
    monkeypatch.chdir(tmp_path)
    run = Path("run.csv")
    run.write_text(run_file(tmp_path).read_text().replace("fan_on", "fan"))
    twin = Path(__file__).parents[3] / "docs" / "examples" / "diagnosis" / "twin.yaml"
    line = refusal(capsys, *(str({"RUN": run, "TWIN": twin}.get(word, word)) for word in words.split()))
    assert "run.csv: unknown column 'fan': is it fan_on?" in line
    assert list(tmp_path.glob("*")) == [tmp_path / "run.csv"]


# plot


@pytest.mark.slow
def test_a_run_and_a_stretch_of_history_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    database = ticks_in_history(tmp_path)
    of_run, of_history = tmp_path / "run.png", tmp_path / "history.png"
    assert main(["plot", str(tmp_path / "run.csv"), "--out", str(of_run)]) == 0
    assert main(["plot", "--history", str(database), "--out", str(of_history)]) == 0
    for picture in (of_run, of_history):
        assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["run.csv", "--out", "p.xyz"], "p.xyz: Format 'xyz' is not supported"),
        (["run.csv", "--out", "none/p.png"], "none/p.png: can't be written"),
        (["run.csv", "--since", "2026-01-01", "--out", "p.png"], "a run file is drawn whole"),
        (["--history", "none.db", "--out", "p.png"], "none.db: unable to open"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_one_line(tmp_path, monkeypatch, capsys, words, reason):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    run_file(tmp_path)
    assert reason in refusal(capsys, "plot", *words)


# fit-arx


def test_a_fitted_model_is_written_with_where_it_comes_from(tmp_path, capsys):
    train, validate, out = run_file(tmp_path), run_file(tmp_path, "other.csv", seed=2), tmp_path / "m.json"
    words = ["fit-arx", "--train", train, "--validate", validate, "--fan", "on", "--out", out]
    assert main([str(word) for word in words]) == 0
    model = read_arx(out)
    assert model.temp[0] == pytest.approx(0.9, abs=1e-3)  # the box that run_file writes
    assert model.heater[0] == pytest.approx(2.0, abs=1e-3)
    facts = json.loads(out.read_text())["provenance"]
    assert facts["command"] == "greenhouse fit-arx --step-s 60 --fan on"
    assert list(facts["training_sha256"]) == ["run.csv"]
    assert list(facts["validation_sha256"]) == ["other.csv"]
    assert str(tmp_path) not in out.read_text()
    assert "chosen" in capsys.readouterr().out


def test_a_fit_without_fan_is_told_in_the_provenance(tmp_path):
    train, out = run_file(tmp_path), tmp_path / "m.json"
    words = ["--train", str(train), "--validate", str(train), "--fan", "none", "--out", str(out)]
    assert main(["fit-arx", *words]) == 0
    assert json.loads(out.read_text())["provenance"]["command"].endswith("--fan none")
    assert not read_arx(out).fan.any()


@pytest.mark.parametrize(("words", "fan_input"), [((), "excess"), (("--no-ambient",), "on")])
def test_the_fan_enters_by_the_excess_wherever_there_is_a_room_temperature(tmp_path, words, fan_input):
    train, out = run_file(tmp_path), tmp_path / "m.json"
    files = ["--train", str(train), "--validate", str(train), "--out", str(out)]
    assert main(["fit-arx", *files, *words]) == 0
    assert read_arx(out).fan_input == fan_input


def test_no_model_is_fitted_on_a_test_run(tmp_path, capsys):
    train, test, out = run_file(tmp_path), tmp_path / "scenario_1.csv", tmp_path / "m.json"
    test.write_text(train.read_text().replace("role: train", "role: test"))
    for files in (["--train", test, "--validate", train], ["--train", train, "--validate", test]):
        line = refusal(capsys, "fit-arx", *files, "--out", out)
        assert f"{test}: role: a test run is never fitted on" in line
    assert not out.exists()


def test_a_model_that_cannot_be_written_is_one_line(tmp_path, capsys):
    train = run_file(tmp_path)
    line = refusal(
        capsys, "fit-arx", "--train", train, "--validate", train, "--out", tmp_path / "no" / "m.json"
    )
    assert "can't be written" in line


# experiment: what is known before a board is started


@pytest.mark.parametrize(
    ("text", "options", "reason"),
    [
        (None, (), "No such file"),
        (BAD_CSV, (), "heater_duty: 2 is not in 0..1"),
        ("time_s,heater_duty\n0,0\n", (), "a profile has time_s and either"),
        (
            "time_s,heater_duty,fan_on\n0,0,0\n60,0,0\n",
            ("--controller", "MPC"),
            "--controller is for references",
        ),
        ("time_s,reference_c\n0,24\n60,24\n", ("--config", "none.yaml"), "none.yaml"),
    ],
)
def test_an_experiment_that_cannot_begin_is_told_in_one_line(tmp_path, capsys, text, options, reason):
    profile = tmp_path / "p.csv"
    if text is not None:
        profile.write_text(text)
    line = refusal(capsys, "experiment", profile, "--out", tmp_path / "r.csv", "--virtual", *options)
    assert reason in line
    assert not (tmp_path / "r.csv").exists()


def test_an_experiment_never_writes_over_a_run(tmp_path, capsys):
    run = run_file(tmp_path)
    before = run.read_bytes()
    profile = tmp_path / "p.csv"
    profile.write_text("time_s,reference_c\n0,24\n60,24\n")
    assert "exists already" in refusal(capsys, "experiment", profile, "--out", run, "--virtual")
    assert run.read_bytes() == before


def test_an_experiment_asks_for_its_folder_before_it_begins(tmp_path, capsys):
    profile = tmp_path / "p.csv"
    profile.write_text("time_s,reference_c\n0,24\n60,24\n")
    line = refusal(capsys, "experiment", profile, "--out", tmp_path / "none" / "r.csv", "--virtual")
    assert "is no folder" in line


# asking a daemon that is not there


@pytest.mark.parametrize(
    "words", [["status"], ["mode", "auto"], ["emergency-stop"], ["reference", "25"], ["watch"]]
)
def test_a_missing_daemon_is_one_line(tmp_path, capsys, words):
    assert "no daemon listens at" in refusal(capsys, *words, "--socket", tmp_path / "none.sock")


def test_a_reference_that_is_no_number_is_a_wrong_argument(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["reference", "warm"])
    assert ended.value.code == 2
    assert "'warm' is not a number from " in capsys.readouterr().err


def test_a_fifo_is_refused_wherever_a_file_is_read(tmp_path, capsys):
    fifo, profile, run = tmp_path / "run.jsonl", tmp_path / "profile.csv", run_file(tmp_path)
    os.mkfifo(fifo)
    profile.write_text("time_s,reference_c\n0,24\n600,24\n")
    out = ("--out", tmp_path / "out.csv")
    assert "not a regular file" in refusal(capsys, "export", "--history", fifo, *out)
    words = ("experiment", "--virtual", profile, *out, "--chamber")
    assert "not a regular file" in refusal(capsys, *words, fifo)
    assert "not a regular file" in refusal(
        capsys, "replay", run, "--controller", "rules", "--again", tmp_path
    )
    fifo.unlink()
    fifo.write_text("[" * 100_000)
    assert "nested too deep" in refusal(capsys, *words, fifo)
    assert "nested too deep" in refusal(capsys, "replay", run, "--controller", "rules", "--again", tmp_path)
