"""bench/foreign: cases that share nothing with the engine, and their score."""

import argparse
import ast
import json
from pathlib import Path

import numpy as np
import pytest

from bench.foreign import __main__ as commands
from bench.foreign import cases, greenhouse
from bench.foreign.box import HOT_ELEMENT_K, BoxWeather, ForeignBox, drive
from bench.foreign.cases import ALIASES, HIDEABLE, KINDS, OUTSIDE, ForeignCase, seed_of
from bench.foreign.make import make_case, name_of, tasks_of, write_case
from bench.foreign.peer import TERMS, sparse
from bench.foreign.run_cases import OURS, PYSINDY, SolverTask, case_sha256, is_done, run_one
from bench.foreign.score import calibration_error, figures, is_alike, score, text
from bench.header import Share
from edge.commands import twin_benchmark
from edge.core.errors import RequestError
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.twin.effects.library import EFFECTS
from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file

FOLDER = Path(cases.__file__).parent
ROWS, STEP_S = 800, 10.0
BOX = ForeignBox(volume_m3=0.02, power_w=40.0, loss_w_k=1.0, contents_j_k=300.0)
RUN = {"wall_s": 10.0, "cpu_s": 10.0}
RUN_ROWS = 160
KNOWN = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 5.0}}
NAMES = list(TERMS)


def still(room_c: float = 20.0) -> BoxWeather:
    return BoxWeather(np.full(ROWS, room_c), np.zeros(ROWS), np.zeros(ROWS), np.ones(ROWS))


def heated(box: ForeignBox, duty: float = 0.5, fan: float = 0.0) -> np.ndarray:
    return drive(box, still(), lambda row, _: (duty, fan), STEP_S)[0][:, 0]


def test_seeds_that_are_not_burnt_begin_later() -> None:
    arguments = argparse.Namespace(
        kinds="null,pair", per_kind=2, seed_from=10, out=Path("out"), split="scored", workers=1
    )
    assert [name_of(task) for task in tasks_of(arguments)] == [
        "case_500010", "case_500011", "case_502010", "case_502011",
    ]  # fmt: skip


def test_the_generator_uses_nothing_of_the_engine() -> None:
    for path in (FOLDER / "box.py", FOLDER / "cases.py", FOLDER / "greenhouse.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [item.name for item in node.names] if isinstance(node, ast.Import) else []
            assert not any(name.startswith(("edge", "training")) for name in names), path


def test_a_box_at_rest_stays_there() -> None:
    assert heated(BOX, duty=0.0) == pytest.approx(20.0)


def test_heat_that_goes_in_is_heat_that_goes_out() -> None:
    assert heated(BOX)[-1] == pytest.approx(20.0 + 0.5 * 40.0 / 1.0, abs=0.05)


@pytest.mark.parametrize(
    ("part", "sign"),
    [
        ({"flow_m3_s": 0.001}, -1), ({"curve": 0.05}, -1), ({"limit": 0.3}, -1), ({"sag": 0.3}, -1),
        ({"base_w": 3.0}, 1), ({"fan_w": 3.0}, 1), ({"free_w_k": 0.5}, -1),
        ({"cutout_c": 30.0, "cutout_gap_k": 2.0}, -1),
        ({"second_w": 8.0, "second_c": 60.0}, 1),
    ],
)  # fmt: skip
def test_a_part_does_what_its_name_says(part: dict[str, float], sign: int) -> None:
    box = ForeignBox(**{"volume_m3": 0.02, "power_w": 40.0, "loss_w_k": 1.0, "contents_j_k": 300.0, **part})
    assert sign * (heated(box, fan=1.0)[-1] - heated(BOX, fan=1.0)[-1]) > 0.2


@pytest.mark.parametrize(
    "part",
    [{"element_s": 120.0}, {"dead_s": 60.0}, {"sensor_s": 90.0}, {"mixing_w_k": 2.0}, {"wall_j_k": 900.0},
     {"store_j_k": 900.0, "store_w_k": 1.0}, {"melts_j": 4000.0, "melts_c": 30.0, "melts_over_k": 2.0}],
)  # fmt: skip
def test_what_stores_or_delays_changes_the_way_and_not_the_end(part: dict[str, float]) -> None:
    other = heated(ForeignBox(volume_m3=0.02, power_w=40.0, loss_w_k=1.0, contents_j_k=300.0, **part))
    plain = heated(BOX)
    assert np.abs(other - plain).max() > 0.5
    assert other[-1] == pytest.approx(plain[-1], abs=1.0)


def test_an_element_is_hot_by_its_power() -> None:
    assert HOT_ELEMENT_K > 100.0
    assert heated(ForeignBox(**{**vars_of(BOX), "element_s": 60.0}))[-1] == pytest.approx(
        heated(BOX)[-1], abs=0.05
    )


def vars_of(box: ForeignBox) -> dict[str, float]:
    return {"volume_m3": box.volume_m3, "power_w": box.power_w, "loss_w_k": box.loss_w_k,
            "contents_j_k": box.contents_j_k}  # type: ignore[dict-item]  # fmt: skip


@pytest.fixture(scope="module")
def few() -> list[ForeignCase]:
    # Of the greenhouse one that shows at the first draw, as its chamber takes a second a draw.
    return [make_case("dev", kind, 903 if kind == greenhouse.HIDDEN else 900) for kind in KINDS]


def test_a_case_is_the_same_whenever_it_is_made(few: list[ForeignCase]) -> None:
    again = make_case("dev", "null", 900)
    assert again.truth == few[0].truth
    for name, log in again.files.items():
        for key, values in log.columns.items():
            assert np.array_equal(values, few[0].files[name].columns[key])


def test_a_case_is_what_a_stranger_would_hand_over(few: list[ForeignCase], tmp_path: Path) -> None:
    for i, case in enumerate(few):
        folder = tmp_path / str(i)
        write_case(case, folder)
        file = read_twin_file(folder / "twin.yaml")
        assert not set(case.truth["hidden"]) & set(file.effects)
        for path in folder.glob("*.csv"):
            run = read_run(path)
            assert np.median(np.diff(run.columns["time_s"])) == pytest.approx(file.sample_s)
            assert np.isfinite(run.columns["temp_air_c"]).all()
            assert 0.0 <= run.columns["heater_duty"].min() <= run.columns["heater_duty"].max() <= 1.0


def test_scored_cases_are_others_than_those_of_development() -> None:
    seeds = {
        split: {seed_of(split, kind, i) for kind in KINDS for i in range(1000)} for split in ("dev", "scored")
    }
    assert not seeds["dev"] & seeds["scored"]


def test_names_are_those_of_the_library() -> None:
    for names in (*ALIASES, HIDEABLE, *cases.PLACES.values(), greenhouse.SETTINGS):
        assert set(names) <= EFFECTS.keys()
    for name, own in greenhouse.SETTINGS.items():
        assert not own.parameter or own.parameter in {item.name for item in EFFECTS[name].parameters}
    words = {"heater_duty", "fan_on", "temp_air", "temp_ambient", "light", "rel_humidity", "time", "none"}
    assert {word for own in OUTSIDE.values() for word in own} <= words


def warmed(settings: greenhouse.Settings) -> np.ndarray:
    """The greenhouse's air without noise: heat from the start, the fan from half time on, the lamp always."""
    day = greenhouse.ChamberDay(hour=10.0, room_c=20.0, light=np.ones(30), seed=1)
    return greenhouse.drive(settings, day, lambda row, _: (1.0, float(row >= 15)))["clean_c"]


def test_every_effect_of_the_greenhouse_changes_its_air() -> None:
    known = {"effects.wall_loss": 1.0, "effects.extra_capacity": 1.0}
    usual = warmed(known)
    for name, own in greenhouse.SETTINGS.items():
        strong = own.low if name in ("heater_saturation", "fan_effectiveness") else own.high
        other = warmed({**known, f"effects.{name}": 1.0, own.place: strong, **dict(own.also)})
        assert np.abs(other - usual).max() > 0.3, name


def test_a_greenhouse_hides_one_effect_that_shows_or_nothing(few: list[ForeignCase]) -> None:
    hidden, null = (case for case in few if case.truth["kind"] in greenhouse.KINDS)
    (name,) = hidden.truth["hidden"]
    low, high = greenhouse.SIZE_K
    assert low <= hidden.truth["shown_k"][name] <= high
    assert null.truth["hidden"] == null.truth["shown_k"] == {}


def test_answers_about_the_greenhouse_count_in_their_own_rows_alone() -> None:
    found = [
        score("a", truth("greenhouse", hidden=LAG), answer({"heater_lag": 0.97}), RUN),
        score("b", truth("greenhouse_null"), answer({"heater_lag": 0.97}), RUN),
    ]
    told = figures(found)
    assert told["greenhouse: first name, strict"] == Share(1, 1)
    assert told["greenhouse: exact, by class"] == Share(1, 1)
    assert told["greenhouse null: something named"] == Share(1, 1)
    assert told["greenhouse: false names"] == Share(1, 2)
    assert told["false names (false discovery rate)"] == told["null: something named"] == Share(0, 0)


def test_wilsons_interval_is_that_of_the_textbook() -> None:
    assert Share(8, 10).interval == pytest.approx((0.4902, 0.9433), abs=5e-5)
    assert Share(0, 0).interval == (0.0, 1.0)


def answer(
    names: dict[str, float], verdict: str = "named", after: float = 0.1, **more: object
) -> dict[str, object]:
    return {
        "verdict": verdict,
        "effects": [
            {"name": name, "probability": probability,
             "parameters": {"tau_h": {"value": 60.0, "low": 50.0, "high": 70.0}}}
            for name, probability in names.items()
        ],
        "doubtful": [],
        "depends_on": [],
        "gap": {"before": {"test": {"rmse_k": 1.0}}, "after": {"test": {"rmse_k": after}}},
        "left_out": {"given_k": 1.0, "after_k": after, "simple_k": {"one mass": 0.8},
                     "test_k": {"one mass": 0.8}},
        "twin_after": "twin.yaml",
        "against_adopting": [],
        **more,
    }  # fmt: skip


def truth(
    kind: str = "single", hidden: dict[str, dict[str, float]] | None = None, outside: str = ""
) -> dict[str, object]:
    return {"kind": kind, "hidden": hidden or {}, "outside": outside,
            "depends_on": list(OUTSIDE.get(outside, ())), "noise_k": 0.05, "step_k": 0.1,
            "known": {}}  # fmt: skip


LAG = {"heater_lag": {"tau_h": 65.0}}


def test_a_name_is_right_strictly_or_by_its_class() -> None:
    strict = score("a", truth(hidden=LAG), answer({"heater_lag": 0.9}), RUN)
    alike = score("a", truth(hidden=LAG), answer({"sensor_lag": 0.9}), RUN)
    wrong = score("a", truth(hidden=LAG), answer({"soil_mass": 0.9}), RUN)
    assert [own.strict for own in (strict, alike, wrong)] == [(True,), (False,), (False,)]
    assert [own.by_class for own in (strict, alike, wrong)] == [(True,), (True,), (False,)]
    assert [own.is_exact for own in (strict, alike, wrong)] == [True, True, False]
    assert strict.covered == (True,)
    assert is_alike("wall_mass", "soil_mass")
    assert not is_alike("wall_mass", "heater_lag")


def test_one_hidden_effect_makes_one_name_right() -> None:
    both = score("a", truth(hidden=LAG), answer({"heater_lag": 0.9, "sensor_lag": 0.9}), RUN)
    assert both.by_class == (True, False)
    assert not both.is_exact


def test_figures_of_a_few_answers() -> None:
    found = [
        score("a", truth(hidden=LAG), answer({"heater_lag": 0.97}), RUN),
        score("b", truth("null"), answer({}, "nothing_missing", 1.0), RUN),
        score("c", truth("null"), answer({"heater_lag": 0.97}), RUN),
        score("d", truth("outside", outside="sun"), answer({}, "unknown", 0.4), RUN),
        score("e", truth(hidden=LAG), None, RUN),
    ]
    told = {
        name: value if isinstance(value, float) else value.value for name, value in figures(found).items()
    }
    assert told["first name, strict"] == 0.5
    assert told["null: something named"] == 0.5
    assert told["outside: unknown said"] == 1.0
    assert told["false names (false discovery rate)"] == 0.5
    assert told["false with probability >= 0.95"] == 0.5
    assert told["no answer"] == 0.2
    assert told["outside: half of the gap closed"] == 1.0
    assert "5 cases" in text(found)


def test_what_is_said_is_held_against_what_held() -> None:
    assert calibration_error([(0.9, True)] * 9 + [(0.9, False)]) == pytest.approx(0.0)
    assert calibration_error([(0.95, False)] * 4) == pytest.approx(0.95)


def test_truth_is_plain_json(few: list[ForeignCase]) -> None:
    for case in few:
        json.dumps(case.truth, allow_nan=False)


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """Two training runs of a box with a lamp, which the twin file does not have."""
    folder = tmp_path / "case_1"
    folder.mkdir()
    (folder / "twin.yaml").write_text(
        "effects: {wall_loss: {UA: {fit: true, start: 2}}, extra_capacity: {kC: {value: 4, rel_sd: 0.3}}}\n"
        "sensor: {quantisation_k: 0.0, noise_sd_k: null}\n"
    )
    twin = BoxTwin(effects={**KNOWN, "led_gain": {"P_led": 20.0}})
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        duty = np.repeat(rng.integers(0, 13, RUN_ROWS // 10) / 20.0, 10)
        fan, light = (np.repeat(rng.random(RUN_ROWS // 20) < 0.4, 20).astype(float) for _ in range(2))
        room, start = np.full(RUN_ROWS, 20.0), np.array([[20.0]])
        shown = twin.rollout(start, duty[None], fan[None], room[None], conditions={"light": light[None]})[0]
        temp = np.concatenate([[20.0], shown[:-1]]) + 0.02 * rng.normal(size=RUN_ROWS)
        columns = {"time_s": 60.0 * np.arange(RUN_ROWS), "temp_air_c": temp, "temp_ambient_c": room,
                   "heater_duty": duty, "fan_on": fan, "light": light}  # fmt: skip
        write_run(RecordedRun(columns, {"role": "train"}), folder / f"train_{seed:02}.csv")
    return folder


def test_the_peer_names_a_lamp_and_its_answer_is_kept_with_its_seconds(case: Path, tmp_path: Path) -> None:
    task = SolverTask(PYSINDY, case, tmp_path / "out", 60.0)
    assert not is_done(task)
    assert run_one(task).startswith("case_1 pysindy")
    took = json.loads((task.out / "run.json").read_text())
    assert took["exit"] == 0, took["stderr"]
    assert took["wall_s"] > 0.0
    assert json.loads((task.out / "diagnosis.json").read_text())["effects"][0]["name"] == "led_gain"
    assert is_done(task)


def test_a_term_is_chosen_only_where_it_pays() -> None:
    rng = np.random.default_rng(3)
    terms, noise = rng.normal(size=(400, len(TERMS))), rng.normal(size=400)
    assert sparse(terms, 5.0 * terms[:, NAMES.index("heater_lag")] + noise) == ["heater_lag"]
    assert sparse(terms, np.zeros(400)) == []


def test_a_diagnosis_that_fails_is_kept_as_one_that_failed(case: Path, tmp_path: Path) -> None:
    (case / "twin.yaml").write_text("effects: {no_such_effect: {}}\n")
    out = tmp_path / "out"
    out.mkdir()
    (out / "diagnosis.json").write_text("{}")  # of an earlier run: it must not count
    assert "failed" in run_one(SolverTask(OURS, case, out, 60.0))
    took = json.loads((out / "run.json").read_text())
    assert took["exit"] != 0
    assert "no_such_effect" in took["stderr"]
    assert took["cpu_s"] > 0.0
    assert not (out / "diagnosis.json").exists()


def test_a_diagnosis_that_takes_too_long_is_stopped(case: Path, tmp_path: Path) -> None:
    run_one(SolverTask(OURS, case, tmp_path / "out", 0.01))
    took = json.loads((tmp_path / "out" / "run.json").read_text())
    assert took["exit"] != 0
    assert "stopped after 0.01 s" in took["stderr"]


def test_other_files_of_a_case_are_another_case(case: Path) -> None:
    before = case_sha256(case)
    (case / "twin.yaml").write_text("effects: {}\n")
    assert case_sha256(case) != before


def test_an_unknown_command_ends_with_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.main(["win"]) == 2
    assert "score" in capsys.readouterr().out


def test_the_benchmark_makes_runs_and_scores_the_same_cases(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    twin_benchmark.add_arguments(parser)
    words = ["--quick", "--out", str(tmp_path), "--kinds", "none_such"]
    steps = twin_benchmark.steps(parser.parse_args(words))
    assert [step[0] for step in steps] == ["make", "run", "score"]
    assert len({tuple(step[1:]) for step in steps}) == 1
    for step in steps:  # each is understood: it is refused for the kind, not for its arguments
        assert commands.main(step) == 2
        assert "there is no kind 'none_such'" in capsys.readouterr().err


def test_without_a_checkout_the_benchmark_says_so(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="checkout"):
        twin_benchmark.refuse_without_checkout(tmp_path)
