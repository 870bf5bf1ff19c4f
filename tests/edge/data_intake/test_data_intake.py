"""`greenhouse data look` and `greenhouse data convert`: logs as strangers write them."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from edge.__main__ import main
from edge.data_intake.look import look
from edge.data_intake.mapping import read_map
from edge.data_intake.units import UNITS, guess_unit
from edge.formats.run_file import read_run

ASKED = {"temp_air_c": "foo", "heater_duty": "bar"}
START = datetime(2024, 2, 13, 10, 0, tzinfo=UTC).timestamp()
ROWS = ((0, 21.5, 20.1, 0), (10, 21.6, 20.1, 50), (20, 22.0, 20.0, 100), (30, 22.6, 20.2, 100))


def written(folder: Path, text: str, name: str = "log.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.fixture
def greenhouse(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def call(*words: object) -> tuple[int, str, str]:
        code = main([str(word) for word in words])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


def converted(greenhouse, path: Path, **changed: str):
    """Look, edit the mapping's text, convert, and read the first run."""
    place, out = path.parent / "map.yaml", path.parent / "runs"
    assert greenhouse("data", "look", path, "--map", place)[0] == 0
    text = place.read_text()
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    place.write_text(text)
    code, said, error = greenhouse("data", "convert", path, "--map", place, "--out", out)
    assert code == 0, error
    return read_run(out / f"{path.stem}_01.csv"), said


def refusal(greenhouse, path: Path, *edit: str) -> str:
    """Return the refusal by `convert` of the edited mapping that `look` made."""
    place = path.parent / "map.yaml"
    assert greenhouse("data", "look", path, "--map", place)[0] == 0
    if edit:
        place.write_text(place.read_text().replace(*edit))
    code, _, error = greenhouse("data", "convert", path, "--map", place, "--out", path.parent / "runs")
    assert code == 2
    return error


def german(times: list[str]) -> str:
    lines = ["Logger 3;;;", "Datum;T_in [°C];Heizung (%);T_room [°C]"]
    for text, (_, air, room, duty) in zip(times, ROWS, strict=True):
        lines.append(
            f"{text};{air:.1f};{duty};{room:.1f}".replace(".", ",").replace(text.replace(".", ","), text)
        )
    return "\n".join(lines) + "\n"


DAYS = [f"13.02.2024 10:00:{second:02d}" for second, *_ in ROWS]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_semicolons_decimal_commas_and_a_title_line(greenhouse, tmp_path: Path, encoding: str) -> None:
    run, _ = converted(greenhouse, written(tmp_path, german(DAYS), encoding=encoding))
    assert run.columns["time_s"].tolist() == [0.0, 10.0, 20.0, 30.0]
    assert run.columns["temp_air_c"].tolist() == [21.5, 21.6, 22.0, 22.6]
    assert run.columns["temp_ambient_c"].tolist() == [20.1, 20.1, 20.0, 20.2]
    assert run.columns["heater_duty"].tolist() == [0.0, 0.5, 1.0, 1.0]
    assert run.facts["fan_on"] == "none"
    assert run.start_utc == START


@pytest.mark.parametrize(
    ("cells", "text", "start"),
    [
        (["2024-02-13T10:00:00Z", "2024-02-13T10:00:10Z", "2024-02-13T10:00:20Z"], "iso", START),
        ([f"2024-02-13 11:00:{s:02d}+01:00" for s in (0, 10, 20)], "iso", START),
        ([f"{START + s:.0f}" for s in (0, 10, 20)], "epoch_s", START),
        ([f"{(START + s) * 1e3:.0f}" for s in (0, 10, 20)], "epoch_ms", START),
        ([f"{(START + s) * 1e6:.0f}" for s in (0, 10, 20)], "epoch_us", START),
        ([f"{(START + s) * 1e9:.0f}" for s in (0, 10, 20)], "epoch_ns", START),
        ([f"{START / 86400 + 25569 + s / 86400:.9f}" for s in (0, 10, 20)], "spreadsheet_days", START),
        (["0", "10", "20"], "seconds", None),
        (["23:59:50", "00:00:00", "00:00:10"], "%H:%M:%S", None),
        ([f"02/13/2024 10:00:{s:02d} AM" for s in (0, 10, 20)], "%m/%d/%Y %I:%M:%S %p", START),
    ],
)  # fmt: skip
def test_times_as_people_write_them(
    greenhouse, tmp_path: Path, cells: list[str], text: str, start: float | None
) -> None:
    lines = [f"{cell},2{i},0.5" for i, cell in enumerate(cells)]
    path = written(tmp_path, "\n".join(["time,temp_air_c,heater_duty", *lines]) + "\n")
    run, _ = converted(greenhouse, path)
    assert read_map(tmp_path / "map.yaml").time_format == text
    assert run.columns["time_s"] == pytest.approx([0.0, 10.0, 20.0], abs=1e-3)
    assert run.start_utc == (None if start is None else pytest.approx(start, abs=1e-3))


def test_a_day_that_could_be_a_month_is_a_guess(tmp_path: Path) -> None:
    path = written(tmp_path, "Date,T,heater\n01/02/2024 10:00,20,0\n01/02/2024 10:01,21,1\n")
    found = look([path])
    assert found.mapping.time_format == "%d/%m/%Y %H:%M"
    assert found.mapping.guesses["time.format"] == "could be %m/%d/%Y %H:%M as well"
    assert found.mapping.guesses["time.zone"] == "the times say no zone"


@pytest.mark.parametrize(
    ("head", "cells", "unit", "values"),
    [
        ("heater_duty", ["0", "0.5", "1"], "share", [0.0, 0.5, 1.0]),
        ("heater [%]", ["0", "50", "100"], "percent", [0.0, 0.5, 1.0]),
        ("heater PWM", ["0", "51", "255"], "0..255", [0.0, 0.2, 1.0]),
        ("heater", ["off", "ON", "off"], "share", [0.0, 1.0, 0.0]),
        ("heater", ["False", "True", "True"], "share", [0.0, 1.0, 1.0]),
        ("heater power [W]", ["0", "150", "300"], "of full", [0.0, 0.5, 1.0]),
    ],
)
def test_units_of_the_heater(
    greenhouse, tmp_path: Path, head: str, cells: list[str], unit: str, values: list[float]
) -> None:
    lines = [f"{10 * i},2{i},{cell}" for i, cell in enumerate(cells)]
    run, _ = converted(greenhouse, written(tmp_path, "\n".join([f"time,temp_air_c,{head}", *lines]) + "\n"))
    assert read_map(tmp_path / "map.yaml").columns["heater_duty"].unit == unit
    assert run.columns["heater_duty"].tolist() == values


@pytest.mark.parametrize(
    ("head", "cells", "unit"),
    [
        ("temp_f", ("68", "77"), "degF"),
        ("temp [K]", ("293.15", "298.15"), "K"),
        ("temp", ("68", "77"), "degF"),
        ("temp", ("20", "25"), "degC"),
    ],
)
def test_units_of_a_temperature(
    greenhouse, tmp_path: Path, head: str, cells: tuple[str, str], unit: str
) -> None:
    path = written(tmp_path, f"time,{head},heater\n0,{cells[0]},0\n10,{cells[1]},1\n")
    run, _ = converted(greenhouse, path)
    assert read_map(tmp_path / "map.yaml").columns["temp_air_c"].unit == unit
    assert run.columns["temp_air_c"] == pytest.approx([20.0, 25.0])


def test_a_spreadsheet(greenhouse, tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(["Time", "Box temp", "Heater", "Fan"])
    for second, air, _, duty in ROWS:
        sheet.append([datetime(2024, 2, 13, 10, 0, second), air, duty / 100.0, duty > 0])
    book.save(tmp_path / "log.xlsx")
    run, _ = converted(greenhouse, tmp_path / "log.xlsx")
    assert run.columns["temp_air_c"].tolist() == [21.5, 21.6, 22.0, 22.6]
    assert run.columns["fan_on"].tolist() == [0.0, 1.0, 1.0, 1.0]
    assert run.start_utc == START


def test_a_gap_begins_a_new_run_that_knows_when_it_began(greenhouse, tmp_path: Path) -> None:
    lines = [f"{START + s:.0f},2{i % 10},0.5" for i, s in enumerate((0, 10, 20, 4000, 4010))]
    path = written(tmp_path, "\n".join(["timestamp,temp,heater", *lines]) + "\n")
    _, said = converted(greenhouse, path)
    assert said.count(" rows") == 2
    second = read_run(tmp_path / "runs" / "log_02.csv")
    assert second.columns["time_s"].tolist() == [0.0, 10.0]
    assert second.start_utc == START + 4000.0


def test_missing_cells_are_missing_and_an_input_holds(greenhouse, tmp_path: Path) -> None:
    path = written(tmp_path, "time,temp,heater\n0,20,0\n10,NaN,\n20,--,1\n30,22,null\n")
    run, _ = converted(greenhouse, path)
    assert np.isnan(run.columns["temp_air_c"]).tolist() == [False, True, True, False]
    assert run.columns["heater_duty"].tolist() == [0.0, 0.0, 1.0, 1.0]


def test_a_repeated_time_is_told_and_its_first_row_counts(greenhouse, tmp_path: Path) -> None:
    path = written(tmp_path, "time,temp,heater\n0,20,0\n0,99,0\n10,21,1\n20,22,1\n")
    run, _ = converted(greenhouse, path)
    assert run.columns["temp_air_c"].tolist() == [20.0, 21.0, 22.0]
    assert "1 times stand there twice" in (tmp_path / "map.yaml").read_text()


def test_what_no_column_sounds_like_is_asked_for(greenhouse, tmp_path: Path) -> None:
    path = written(tmp_path, "time,foo,bar\n0,20,0\n10,21,1\n")
    said = greenhouse("data", "look", path, "--map", tmp_path / "map.yaml")[1]
    assert "columns.temp_air_c: no column sounds like it" in said
    assert "there is no column '?'" in refusal(greenhouse, path)
    named = {f"{name}: {{from: '?'": f"{name}: {{from: {own}" for name, own in ASKED.items()}
    run, _ = converted(greenhouse, path, **named)
    assert run.columns["temp_air_c"].tolist() == [20.0, 21.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,temp,heater\n0,20,0\n10,warm,1\n20,21,1\n30,21,1\n40,21,1\n50,2,1\n60,2,1\n70,2,1\n80,2,1\n90,2,1\n99,2,1\n",
         "log.csv: line 3: temp: 'warm' is no number"),
        ("time,temp,heater\n0,20,\n10,21,1\n", "log.csv: line 2: heater: empty in the first row"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_refused_by_line_and_column(
    greenhouse, tmp_path: Path, text: str, message: str
) -> None:
    assert message in refusal(greenhouse, written(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("unit: share", "unit: percentage", "columns.heater_duty.unit: 'percentage' is none of share"),
        ("unit: share", "unit: of full", "columns.heater_duty.full: the unit `of full` needs the number"),
        ("format: seconds", "format: fortnights", "time.format: 'fortnights' is none of iso"),
        ("zone: UTC", "zone: Mars/Olympus", "time.zone: 'Mars/Olympus' is no time zone"),
        ("temp_air_c:", "temp_air:", "columns: unknown key 'temp_air'; did you mean 'temp_air_c'?"),
    ],
)
def test_a_wrong_mapping_is_refused_by_its_key(
    greenhouse, tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = written(tmp_path, "time,temp_air_c,heater_duty\n0,20,0\n10,21,1\n")
    assert message in refusal(greenhouse, path, old, new)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x00\x01\x02", b"PK\x03\x04nonsense", b"a,b\n", b"time,temp,temp\n0,1,2\n", b"\xff\xfea"],
)
def test_what_is_no_log_is_refused_in_one_line(greenhouse, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    code, _, error = greenhouse("data", "look", path, "--map", tmp_path / "map.yaml")
    assert code == 2
    assert "Traceback" not in error
    assert error.count("\n") == 1


def test_files_with_other_columns_are_not_mixed(greenhouse, tmp_path: Path) -> None:
    one = written(tmp_path, "time,temp,heater\n0,20,0\n10,21,1\n")
    two = written(tmp_path, "time,temp,duty\n0,20,0\n10,21,1\n", "other.csv")
    code, _, error = greenhouse("data", "look", one, two, "--map", tmp_path / "map.yaml")
    assert code == 2
    assert "other.csv: has other columns than" in error


@pytest.mark.parametrize(
    ("fans", "between"),
    [("0 40 100", True), ("0 0.4 1", True), ("0 102 255", True), ("0 100 100", False), ("off on off", False)],
)
def test_a_fan_between_off_and_on_is_a_guess(greenhouse, tmp_path: Path, fans: str, between: bool) -> None:
    rows = "".join(f"{10 * k},2{k},0,{fan}\n" for k, fan in enumerate(fans.split()))
    path = written(tmp_path, "time,temp,heater,fan_pwm\n" + rows)
    said = greenhouse("data", "look", path, "--map", tmp_path / "map.yaml")[1]
    assert ("say `fan_control: speed` in the twin file" in said) == between
    assert ("`fan_control: speed`" in (tmp_path / "map.yaml").read_text()) == between


@pytest.mark.parametrize(
    ("values", "unit", "read"), [([0.0, 480.0, 910.0], "W/m2", 910.0), ([0.0, 0.48, 0.91], "kW/m2", 910.0)]
)
def test_sun_is_read_in_watts_or_kilowatts(values: list[float], unit: str, read: float) -> None:
    guessed, full, why = guess_unit("solar_w_m2", np.array(values), "ghi")
    assert (guessed, full) == (unit, None)
    assert bool(why) == (unit == "kW/m2")
    assert UNITS[guessed].to_ours(np.array(values), 1.0).max() == pytest.approx(read)
