"""`greenhouse twin diagnose`, from files to a report, with every effect of the library as a candidate."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from edge.__main__ import main
from edge.diagnosis.diagnosis_file import check_diagnosis, schema
from edge.formats.run_file import RecordedRun, absence_facts, data_sha256, write_run
from edge.models.pbm import read_twin
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from tests.support.simulated_runs import BOX, Effects, Heat, candidates_only, change_run, simulate, twin_file

pytestmark = pytest.mark.slow

RUNS, ROWS = 4, 60  # time goes with the rows of a run, not with how many there are
CANDIDATES = ("infiltration", "heater_lag", "sensor_lag")
LAG: Effects = {"heater_lag": {"tau_h": 200.0}}


@dataclass(frozen=True)
class CommandOutput:
    """The output of the command, on the terminal and in files."""

    code: int
    out: str
    err: str
    folder: Path

    @property
    def refusal(self) -> str:
        """Return the one line of a refused command, without its progress."""
        assert self.code == 2
        assert "Traceback" not in self.err
        return self.err.splitlines()[-1].removeprefix("greenhouse twin: ")

    @property
    def document(self) -> dict[str, Any]:
        """diagnosis.json, which is JSON in the strict sense, with numbers that are numbers, by its schema."""
        assert self.code == 0, self.err
        text = (self.folder / "diagnosis.json").read_text(encoding="utf-8")
        document: dict[str, Any] = json.loads(text, parse_constant=_no_number)
        check_diagnosis(document)
        Draft202012Validator(schema()).validate(document)
        return document


def _no_number(text: str) -> None:
    raise AssertionError(f"{text} is no JSON")


def recordings(hidden: Effects, **more: Any) -> list[RecordedRun]:
    return [simulate({**BOX, **hidden}, seed, ROWS, **more) for seed in range(1, RUNS + 1)]


def blind_test(hidden: Effects) -> RecordedRun:
    """A run of role test with temperatures in its first two rows alone."""
    run = simulate({**BOX, **hidden}, 9, ROWS)
    temp = run.columns["temp_air_c"].copy()
    temp[2:] = np.nan
    return change_run(run, facts={"role": "test"}, temp_air_c=temp)


Command = Callable[..., CommandOutput]


def written(runs: Sequence[RecordedRun], folder: Path, name: str) -> list[str]:
    paths = [folder / f"{name}_{i:02d}.csv" for i in range(1, len(runs) + 1)]
    for run, path in zip(runs, paths, strict=True):
        write_run(absence_facts(run), path)
    return [str(path) for path in paths]


def words_for(
    folder: Path, train: Sequence[RecordedRun], test: Sequence[RecordedRun] = (), file: TwinFile | None = None
) -> list[str]:
    """The command's words, its files written."""
    folder.mkdir(exist_ok=True)
    write_twin_file(file or twin_file(), folder / "twin.yaml")
    tests = ["--test", *written(test, folder, "test")] if test else []
    told = ["--twin", str(folder / "twin.yaml"), "--out", str(folder / "report"), "--json-only"]
    return ["twin", "diagnose", *written(train, folder, "train"), *tests, *told]


@pytest.fixture
def diagnose(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Command:
    def run(*words: str) -> CommandOutput:
        capsys.readouterr()
        code = main(list(words))
        said = capsys.readouterr()
        return CommandOutput(code, said.out, said.err, tmp_path / "report")

    return run


# the three answers


@pytest.fixture
def few_candidates() -> Iterator[None]:
    """For what does not depend on how many effects there are, and takes long with all."""
    with candidates_only(*CANDIDATES):
        yield


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> CommandOutput:
    """The whole report, by the program as it is started: a slow heater that the twin does not know."""
    folder = tmp_path_factory.mktemp("named")
    words = words_for(folder, recordings(LAG), [blind_test(LAG)])
    words.remove("--json-only")
    ended = subprocess.run(
        [sys.executable, "-m", "edge", *words], capture_output=True, text=True, check=False, timeout=110
    )
    return CommandOutput(ended.returncode, ended.stdout, ended.stderr, folder / "report")


def test_what_is_hidden_is_named_with_its_value(named: CommandOutput) -> None:
    document = named.document
    assert document["verdict"] == "named"
    [effect] = document["effects"]
    assert effect["name"] == "heater_lag"
    assert effect["alternatives"] == []
    assert effect["log_odds"] > 20.0
    value = effect["parameters"]["tau_h"]
    assert value["low"] < 200.0 < value["high"]
    assert value["high"] - value["low"] < 40.0
    assert value["unit"] == "s"
    assert effect["equation"] == "The element warms up before it heats: tau_h dP/dt = H - P."
    assert document["depends_on"] == []
    assert document["formula"] is None


def test_the_gap_closes_and_is_shown_step_by_step(named: CommandOutput) -> None:
    gap = named.document["gap"]
    before, after = gap["before"]["train"]["rmse_k"], gap["after"]["train"]["rmse_k"]
    assert after < 0.2 * before
    assert after < 1.5 * gap["noise_floor"]["train"]
    assert set(gap["after"]["train"]["per_run"]) == {f"train_0{i}.csv" for i in range(1, RUNS + 1)}
    steps = named.document["waterfall"]
    assert [step["effects"] for step in steps] == [[], ["heater_lag"]]
    assert [step["train_rmse_k"] for step in steps] == [before, after]


def test_a_test_run_with_two_temperatures_is_forecast_but_judges_nothing(named: CommandOutput) -> None:
    document = named.document
    assert document["gap"]["after"]["test"] is None
    series = document["predictions"]["test_01.csv"]
    assert set(series) == {"before", "after"}
    assert all(len(values) == ROWS for values in series.values())
    truth = simulate({**BOX, **LAG}, 9, ROWS).columns["temp_air_c"]
    missed = {key: np.sqrt(np.mean((np.array(values) - truth) ** 2)) for key, values in series.items()}
    assert missed["after"] < 0.3 * missed["before"]
    assert missed["after"] < 0.5


def test_without_a_row_to_judge_by_a_test_has_no_noise_floor(named: CommandOutput) -> None:
    assert named.document["gap"]["noise_floor"]["test"] is None


def test_the_report_folder_holds_what_a_person_a_machine_and_the_rig_need(named: CommandOutput) -> None:
    names = {path.name for path in named.folder.iterdir()}
    assert {"report.html", "diagnosis.json", "twin.yaml", "twin_before.yaml"} <= names
    assert "heater_lag" in (named.folder / "report.html").read_text(encoding="utf-8")
    assert "heater_lag" in named.out
    assert named.document["twin_after"] == "twin.yaml"


def test_the_new_twin_is_one_that_predicts(named: CommandOutput) -> None:
    file = read_twin_file(named.folder / "twin.yaml")
    assert set(file.effects) == {*BOX, "heater_lag"}
    assert file.to_fit() == []
    value = file.effects["heater_lag"]["tau_h"]
    assert value.low is not None
    assert value.high is not None
    assert value.low < value.value < value.high
    origin = file.provenance
    assert origin["data_sha256"] == data_sha256(recordings(LAG)) == named.document["data_sha256"]
    assert origin["after"]["train"]["rmse_k"] < 0.2 * origin["before"]["train"]["rmse_k"]
    assert "heater_lag" in origin["added"]
    air = [run.columns["temp_air_c"] for run in recordings(LAG)]
    assert origin["validity"]["temp_air_c"] == pytest.approx([np.min(air), np.max(air)], abs=0.05)
    assert origin["validity"]["hours"] == pytest.approx(ROWS / 60.0, abs=0.05)
    names = [f"effects.{name}.{key}" for name, own in file.effects.items() for key in own]
    together = origin["correlation"]
    assert set(together["values"]) & set(names)
    assert "effects.heater_lag.tau_h" in together["values"]
    assert [row[-1] for row in together["rows"]] == [1.0] * len(together["values"])
    pbm = read_twin(named.folder / "twin.yaml")
    history = {key: np.full(3, 22.0) for key in ("temp_air", "temp_ambient")} | {
        key: np.zeros(3) for key in ("heater_duty", "fan_on")
    }
    controls = np.zeros((1, 30, 2))
    controls[..., 0] = 0.5
    warmed = pbm.rollout(history, controls, {"temp_ambient": np.full(30, 22.0)})
    assert warmed[0, -1] == pytest.approx(22.0 + 50.0 / 4.0, abs=1.0)  # 50 W over 4 W/K, nearly settled


def test_nothing_is_said_to_be_missing_where_nothing_is(diagnose: Command, tmp_path: Path) -> None:
    told = diagnose(*words_for(tmp_path, recordings({}), [blind_test({})]))
    document = told.document
    assert document["verdict"] == "nothing_missing"
    assert document["effects"] == []
    assert document["twin_after"] is None
    assert document["gap"]["before"] == document["gap"]["after"]
    assert not (tmp_path / "report" / "twin.yaml").exists()
    assert read_twin_file(tmp_path / "report" / "twin_before.yaml").effects == twin_file().effects


@pytest.mark.usefixtures("few_candidates")
@pytest.mark.parametrize(
    ("heat", "signals", "formula", "size"),
    [
        (lambda duty, fan, _: 40.0 * fan, {"fan_on"}, "Q = a fan", 40.0),
        (lambda duty, fan, _: 15.0 * duty * fan, {"heater_duty", "fan_on"}, None, None),
        (lambda duty, fan, _: -40.0 * duty**2, {"heater_duty"}, "Q = a u^2", -40.0),
    ],
    ids=["a fan that heats", "a heater by the fan", "a heater that is weaker when hot"],
)
def test_what_has_no_name_is_unknown_with_a_formula(
    heat: Heat, signals: set[str], formula: str | None, size: float | None, diagnose: Command, tmp_path: Path
) -> None:
    document = diagnose(*words_for(tmp_path, recordings({}, further=heat))).document
    assert document["verdict"] == "unknown"
    assert document["effects"] == []
    assert signals <= set(document["depends_on"])
    if formula is not None:
        assert document["formula"]["text"] == formula
        found = document["formula"]["parameters"]["a"]
        assert found["unit"] == "W"
        assert found["value"] == pytest.approx(size, rel=0.1)


# honest answers to poor data


def with_readings(run: RecordedRun, added: dict[int, float]) -> RecordedRun:
    temp = run.columns["temp_air_c"].copy()
    for row, more in added.items():
        temp[row] += more
    return change_run(run, temp_air_c=temp)


@pytest.mark.usefixtures("few_candidates")
def test_bad_readings_do_not_hide_what_is_missing(diagnose: Command, tmp_path: Path) -> None:
    one, two, three, four = recordings(LAG)
    rows = np.r_[0:25, 40:ROWS]  # 15 min without a row
    torn = RecordedRun({key: values[rows] for key, values in one.columns.items()}, one.facts, one.path)
    holes = np.where(np.arange(ROWS) % 7 == 3, np.nan, two.columns["temp_air_c"])
    spiky = with_readings(three, {0: 8.0, 30: -7.0})
    stuck = four.columns["temp_air_c"].copy()
    stuck[:10], stuck[35:45] = stuck[0], stuck[35]
    runs = [torn, change_run(two, temp_air_c=holes), spiky, change_run(four, temp_air_c=stuck)]
    document = diagnose(*words_for(tmp_path, runs)).document
    [effect] = document["effects"]
    assert effect["name"] == "heater_lag"
    assert effect["parameters"]["tau_h"]["low"] < 200.0 < effect["parameters"]["tau_h"]["high"]
    said = " ".join(document["findings"])
    assert "train_01.csv is cut into 2 pieces" in said
    assert "temperatures of the training runs can't be what the air had" in said
    # What was taken out is no error of the twin either.
    assert document["gap"]["after"]["train"]["per_run"]["train_03.csv"]["rmse_k"] < 0.5


@pytest.mark.usefixtures("few_candidates")
def test_a_room_and_a_fan_that_were_not_recorded_are_said_to_be_so(diagnose: Command, tmp_path: Path) -> None:
    runs = [
        change_run(with_room(run, 21.0), temp_ambient_c=None, fan_on=None)
        for run in recordings({}, fan=False)
    ]
    test = change_run(runs[3], facts={"role": "test"})
    document = diagnose(*words_for(tmp_path, runs[:3], [test])).document
    assert document["verdict"] == "nothing_missing"
    said = " ".join(document["findings"])
    assert "the room temperature was not recorded" in said
    assert "the fan was not recorded and counts as still" in said
    assert document["gap"]["after"]["test"]["rmse_k"] < 1.0
    assert len(document["predictions"]["test_01.csv"]["after"]) == ROWS


def with_room(run: RecordedRun, room_c: float) -> RecordedRun:
    """The plain box's run again in a room that stands still."""
    from edge.twin.model import BoxTwin

    duty, fan = (run.columns[key][None, :-1] for key in ("heater_duty", "fan_on"))
    temp = BoxTwin(effects=BOX).rollout(np.array([room_c]), duty, fan, room_c)[0]
    noise = 0.1 * np.random.default_rng(len(str(run.path))).standard_normal(ROWS)
    return change_run(run, temp_air_c=np.append(room_c, temp) + noise, temp_ambient_c=np.full(ROWS, room_c))


@pytest.mark.parametrize(("noise_k", "declared"), [(0.0, False), (0.1, True)])
@pytest.mark.usefixtures("few_candidates")
def test_a_box_that_is_left_alone_tells_nothing_and_that_is_said(
    diagnose: Command, tmp_path: Path, noise_k: float, declared: bool
) -> None:
    still = np.zeros(ROWS)
    noise = noise_k * np.random.default_rng(1).standard_normal(ROWS)
    run = change_run(
        recordings({})[0], temp_air_c=21.0 + noise, temp_ambient_c=still + 21.0, heater_duty=still,
        fan_on=still, light=still,
    )  # fmt: skip
    file = twin_file() if declared else replace(twin_file(), sensor={}, nuisance={})
    told = diagnose(*words_for(tmp_path, [run], file=file))
    assert told.document["verdict"] == "nothing_missing"
    said = " ".join(told.document["findings"])
    sentences = ("the heater never heats", "the fan never runs", "losses can hardly be told")
    for sentence in (*sentences, "there is one training run"):
        assert sentence in said


@pytest.mark.usefixtures("few_candidates")
def test_one_run_and_a_twin_without_any_noise_are_enough_for_an_answer(
    diagnose: Command, tmp_path: Path
) -> None:
    silent = replace(
        twin_file(),
        sensor={"noise_sd_k": 0.0, "quantisation_k": 0.0},
        nuisance={"heater_power_run_sd": 0.0, "heat_noise_sd_w": 0.0},
    )
    document = diagnose(*words_for(tmp_path, recordings(LAG)[:1], file=silent)).document
    assert document["verdict"] == "named"
    assert "heater_lag" in {effect["name"] for effect in document["effects"]}


@pytest.mark.usefixtures("few_candidates")
def test_values_that_are_uncertain_or_open_are_found_beside_what_is_missing(
    diagnose: Command, tmp_path: Path
) -> None:
    text = (
        "geometry: {heater_max_w: {value: 104.0, rel_sd: 0.05}}\n"
        "effects:\n"
        "  wall_loss: {UA: {fit: true, start: 40.0}}\n"
        "  extra_capacity: {kC: {value: 11.0, rel_sd: 0.1}}\n"
    )
    words = words_for(tmp_path, recordings(LAG)[:2])
    (tmp_path / "twin.yaml").write_text(text)
    document = diagnose(*words).document
    assert [effect["name"] for effect in document["effects"]] == ["heater_lag"]
    file = read_twin_file(tmp_path / "report" / "twin.yaml")
    found = {".".join(place[-2:]): value for place, value in file.values().items()}
    # The truth is 100 W, 4 W/K and 10; only two of the three are told by temperatures alone.
    assert found["wall_loss.UA"].value / found["geometry.heater_max_w"].value == pytest.approx(0.04, rel=0.05)
    assert found["extra_capacity.kC"].value == pytest.approx(10.0, rel=0.1)
    assert all(value.low is not None for value in (found["wall_loss.UA"], found["geometry.heater_max_w"]))


# refused


def edited(path: str, change: Callable[[list[str]], list[str]]) -> None:
    place = Path(path)
    place.write_text("\n".join(change(place.read_text().splitlines())) + "\n")


def swapped(lines: list[str]) -> list[str]:
    return [*lines[:40], lines[41], lines[40], *lines[42:]]


def short(run: RecordedRun, rows: int) -> RecordedRun:
    return RecordedRun({key: values[:rows] for key, values in run.columns.items()}, run.facts, run.path)


def kelvin(run: RecordedRun) -> RecordedRun:
    return change_run(run, temp_air_c=run.columns["temp_air_c"] + 273.15)


def percent(run: RecordedRun) -> RecordedRun:
    return change_run(run, heater_duty=100.0 * run.columns["heater_duty"])


def empty(run: RecordedRun) -> RecordedRun:
    return change_run(run, temp_air_c=np.full(len(run), np.nan))


REFUSED: dict[str, tuple[Callable[[RecordedRun], RecordedRun], str]] = {
    "ten rows": (lambda run: short(run, 10), "10 usable rows: these data can't tell anything"),
    "all missing": (empty, "temp_air_c: nothing was measured, every cell is empty"),
    "kelvin": (kelvin, "is not a plausible air temperature in degC; is it kelvin?"),
    "percent": (percent, "heater_duty: 60 is not in 0..1; is the column in percent?"),
    "milliseconds": (
        lambda run: change_run(run, time_s=1000.0 * run.columns["time_s"]),
        "rows are 60000 s apart, more than 600 s; is it in milliseconds?",
    ),
    "a test run": (lambda run: change_run(run, facts={"role": "test"}), "a test run is never fitted on"),
    "no duty": (lambda run: change_run(run, heater_duty=None), "heater_duty is not among the columns"),
    "a bad start": (lambda run: change_run(run, facts={"start_utc": "noon"}), "start_utc: 'noon' is no time"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_run_that_can_not_be_used_is_refused_by_name(case: str, diagnose: Command, tmp_path: Path) -> None:
    spoilt, expected = REFUSED[case]
    refusal = diagnose(*words_for(tmp_path, [spoilt(recordings({})[0])])).refusal
    assert refusal.startswith(f"{tmp_path / 'train_01.csv'}: ")
    assert expected in refusal
    assert not (tmp_path / "report").exists()


def test_time_that_goes_backwards_is_refused_at_its_line(diagnose: Command, tmp_path: Path) -> None:
    words = words_for(tmp_path, recordings({})[:2])
    edited(str(tmp_path / "train_02.csv"), swapped)
    refusal = diagnose(*words).refusal
    assert refusal.startswith(f"{tmp_path / 'train_02.csv'}: line 42: time_s: ")
    assert refusal.endswith("time goes backwards")


def test_a_run_that_is_training_and_test_is_refused(diagnose: Command, tmp_path: Path) -> None:
    run = recordings({})[0]
    refusal = diagnose(*words_for(tmp_path, [run], [run])).refusal
    assert refusal == f"{tmp_path / 'test_01.csv'}: is the same recording as {tmp_path / 'train_01.csv'}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("effects: {heater_lagg: {tau: 3}}", "effects: unknown effect 'heater_lagg'; did you mean 'heater"),
        ("effects: {wall_mass: {C_w: 3000}}", "effects.wall_mass.G_in: missing"),
        ("effects: {wall_loss: {UA: -3}}", "effects.wall_loss.UA: -3 is outside 0..1e+06 W/K"),
        ("effects: {wall_loss: {UA: .nan}}", "effects.wall_loss.UA: nan is not a finite number"),
        ("geometry: {volume_m3: 0}", "geometry.volume_m3: 0 is not a finite number above 0"),
        ("sample_s: -1", "sample_s: -1 is not a finite number above 0"),
        ("nuisances: {}", "unknown key 'nuisances'"),
        ("effects: [", "not YAML"),
    ],
)  # fmt: skip
def test_a_twin_file_that_is_wrong_is_refused_by_key(
    text: str, expected: str, diagnose: Command, tmp_path: Path
) -> None:
    words = words_for(tmp_path, recordings({})[:1])
    (tmp_path / "twin.yaml").write_text(text + "\n")
    refusal = diagnose(*words).refusal
    assert refusal.startswith(f"{tmp_path / 'twin.yaml'}: {expected}")


def test_a_twin_that_needs_a_column_which_the_runs_lack_is_refused(diagnose: Command, tmp_path: Path) -> None:
    lit = twin_file({**BOX, "led_gain": {"P_led": 5.0}})
    dark = [change_run(run, light=None) for run in recordings({})[:1]]
    refusal = diagnose(*words_for(tmp_path, dark, file=lit)).refusal
    assert refusal == f"{tmp_path / 'train_01.csv'}: light: missing, the twin's led_gain needs it"


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/none"])
def test_a_folder_that_can_not_be_written_is_told_before_anything_is_computed(
    place: str, diagnose: Command, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    words = words_for(tmp_path, recordings({})[:1])
    words[words.index("--out") + 1] = str(tmp_path / place)
    told = diagnose(*words)
    assert told.refusal.startswith(f"{tmp_path / place}: can't be written: ")
    assert told.err.count("\n") == 1  # no progress before it


def test_files_that_are_not_there_are_named(diagnose: Command, tmp_path: Path) -> None:
    words = words_for(tmp_path, recordings({})[:1])
    (tmp_path / "train_01.csv").unlink()
    assert diagnose(*words).refusal.startswith(f"{tmp_path / 'train_01.csv'}: ")
    words = words_for(tmp_path, recordings({})[:1])
    assert "nothing to diagnose" in diagnose("twin", "diagnose", *words[3:]).refusal
    (tmp_path / "twin.yaml").unlink()
    assert diagnose(*words).refusal.startswith(f"{tmp_path / 'twin.yaml'}: cannot be read")
