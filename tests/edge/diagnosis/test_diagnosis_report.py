"""The report: its page, its pictures, its summary; and progress while a diagnosis works."""

import importlib.util
import io
import json
import re
import subprocess
import sys
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_examples import STORIES, named_story, nothing_story

from edge.core.errors import DataError
from edge.diagnosis.answer import _formula
from edge.diagnosis.depends import Dependence
from edge.diagnosis.progress import Stage, TerminalProgress
from edge.diagnosis.report.markup import paragraph
from edge.diagnosis.report.number_text import duration, kelvin, nats, number, odds, percent, plus_minus
from edge.diagnosis.report.page import write_report
from edge.diagnosis.report.picture import new_figure
from edge.diagnosis.report.pictures import error_axis, pictures, shown_run
from edge.diagnosis.report.residual_plots import cross_correlations, cumulated_periodogram
from edge.diagnosis.report.run_picture import limits, residual_limits
from edge.diagnosis.report.story import Story, Trace, worst_stretch
from edge.diagnosis.report.summary import summary_text
from edge.diagnosis.report.wording import (
    doors,
    doubtful,
    effect_lines,
    effect_name,
    gap_sentence,
    headline,
    join_names,
    known_name,
    shrink,
    step_names,
    where,
)
from edge.twin.effects.library import EFFECTS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
VOID = {"meta", "br", "img", "path", "use", "image", "rect"}
HEADLINES = {
    "named": "Two effects are missing: the element warms up before it heats (heater_lag) and share of the"
    " rated flow that changes air, against the filters (fan_effectiveness, or short_circuit)",
    "nothing_missing": "Nothing is missing: no effect of the library makes the twin better",
    "unknown": "Something is missing that has no name here: it depends on the heater's duty (heater_duty) and"
    " the temperature of the air (temp_air)",
}
SECTIONS = ["Where and when it shows", "What the new twin changes", "What would tell more"]


class Outline(HTMLParser):
    """Checks that elements are closed in order, and keeps the text outside pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"svg", "style"} & set(self.open):
            self.text.append(data)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The page of every example."""
    folder = tmp_path_factory.mktemp("reports")
    for name, story in STORIES.items():
        write_report(folder / name, story())
    return {name: (folder / name / "report.html").read_text(encoding="utf-8") for name in STORIES}


def words(page: str) -> str:
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    return " ".join(" ".join(outline.text).split())


def changed_document(story: Story, **keys: Any) -> Story:
    return replace(story, document={**story.document, **keys})


@pytest.mark.parametrize("name", STORIES)
def test_the_page_leads_with_the_verdict_in_words(pages: dict[str, str], name: str) -> None:
    assert f"<h1>{escape(HEADLINES[name])}</h1>" in pages[name]
    assert words(pages[name]).count(HEADLINES[name]) == 2  # in the title of the window too


@pytest.mark.parametrize("name", STORIES)
def test_the_page_needs_nothing_beside_it(pages: dict[str, str], name: str) -> None:
    assert "http" not in pages[name]
    assert "<script" not in pages[name] and "<link" not in pages[name] and "@import" not in pages[name]
    targets = re.findall(r'(?:href|src)="([^"]*)"', pages[name])
    assert all(target.startswith(("#", "data:image/png;base64,")) for target in targets)
    assert "nan" not in words(pages[name]).lower().split()


@pytest.mark.parametrize(
    ("name", "figures"),
    [("named", 4), ("nothing_missing", 3), ("unknown", 3)],  # no waterfall there
)
def test_every_picture_is_there_in_the_colours_of_the_page(
    pages: dict[str, str], name: str, figures: int
) -> None:
    assert pages[name].count("<figure") == figures
    assert pages[name].count("<svg") == figures
    assert "currentColor" in pages[name] and "var(--after)" in pages[name]
    assert "#010203" not in pages[name]


def test_the_page_tells_the_gap_the_effects_the_odds_and_what_to_do(pages: dict[str, str]) -> None:
    text = words(pages["named"])
    for said in (
        "The element warms up before it heats (heater_lag): tau_h dP/dt = H - P",
        "tau_h = 418 s (95 %: 402 to 435); probability 0.95.",
        "cannot tell it from supply air that leaves before it mixes (short_circuit, odds even).",
        "100 % of the gap is closed",
        "58 %: within 15 min of a change of the duty; there the twin gains 14.2 ± 0.9 W too much",
        "heater_lag: negative for minutes after the heater goes on",
        "A door or lid was open, found and not recorded: train_02.csv 1:10:00 to 1:13:00 (-61 W).",
        "test_01.csv held-out test runs",
        "A pseudo-random fan sequence",
        "The air gets up to 38.2 °C.",
        "greenhouse experiment",
        "greenhouse twin adopt",
        "9f2c4b8e" * 8,
        "greenhouse-twin 0.1.0",
    ):
        assert said in text, said


def test_the_page_goes_from_what_to_where_to_what_to_do(pages: dict[str, str]) -> None:
    assert re.findall("<h2>(.*?)</h2>", pages["named"]) == SECTIONS
    first = pages["named"].index("<h3>The element"), pages["named"].index("<figure>")
    assert first[0] < pages["named"].index(f"<h2>{SECTIONS[0]}") < first[1]


@pytest.mark.parametrize("name", STORIES)
def test_page_and_terminal_say_the_same(pages: dict[str, str], name: str) -> None:
    document = STORIES[name]().document
    page, terminal = words(pages[name]), " ".join(summary_text(document).split())
    said = [headline(document), *where(document)[:2], doors(document), *doubtful(document)]
    said += ["; ".join(effect_lines(effect)[2]) for effect in document["effects"]]
    for sentence in said:
        assert sentence in page.replace("\N{NO-BREAK SPACE}", " "), sentence
        assert sentence in terminal, sentence


def test_every_picture_says_what_it_shows(pages: dict[str, str]) -> None:
    labels = re.findall('<svg role="img" aria-label="([^"]+)"', pages["named"])
    assert len(labels) == len(set(labels)) == pages["named"].count("<svg")
    assert any("the twin as given 2.87, + heater_lag" in label for label in labels)


def test_a_number_and_its_unit_stay_on_one_line() -> None:
    line = paragraph("71 % of it: 38 ± 3 W in 5 min, of 3 runs")
    assert line == "<p>71\N{NO-BREAK SPACE}% of it: 38\xa0±\xa03\xa0W in 5\xa0min, of 3 runs</p>"


@pytest.mark.parametrize(
    ("text", "formula"),
    [("RH - 50", "Q = a (RH - 50)"), ("u (T - T_amb)", "Q = a u (T - T_amb)"),
     ("|T - T_amb| (T - T_amb)", "Q = a |T - T_amb| (T - T_amb)"),
     ("u max(T - 31, 0)", "Q = a u max(T - 31, 0)")],
)  # fmt: skip
def test_a_sum_is_a_factor_inside_brackets(text: str, formula: str) -> None:
    found = _formula([Dependence(text, "W", ("temp_air",), 1.0, 2.0)])
    assert found is not None and found["text"] == formula


def test_an_unknown_effect_comes_with_its_dependence_and_formula(pages: dict[str, str]) -> None:
    text = words(pages["unknown"])
    assert "Q = a u^2, with a = -21.6 W (95 %: -23.1 to -20.2)" in text
    assert "greenhouse twin adopt" not in text


def test_where_nothing_was_added_nothing_is_adopted(pages: dict[str, str]) -> None:
    text = words(pages["nothing_missing"])
    assert "of the gap" not in text and "greenhouse twin adopt" not in text
    assert "No experiment is open." in text


def test_the_json_lies_beside_the_page(tmp_path: Path) -> None:
    story = nothing_story()
    write_report(tmp_path / "report", Story(story.document))
    assert json.loads((tmp_path / "report" / "diagnosis.json").read_text()) == json.loads(
        json.dumps(story.document)
    )


def test_an_error_that_is_spread_evenly_is_said_to_be(tmp_path: Path) -> None:
    write_report(tmp_path, Story({**nothing_story().document, "regimes": []}))
    assert "No regime has clearly more of the error" in words((tmp_path / "report.html").read_text("utf-8"))


def test_a_wrong_diagnosis_gets_no_report(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="seconds: nan"):
        write_report(tmp_path, changed_document(nothing_story(), seconds=float("nan")))
    assert list(tmp_path.iterdir()) == []


def test_names_are_escaped(tmp_path: Path) -> None:
    wicked = '<img src=x onerror="alert(1)">&$x_1$\udc80.csv'
    story = nothing_story()
    traces = tuple(replace(one, name=wicked) for one in story.traces[:1])
    gap = json.loads(json.dumps(story.document["gap"]).replace("train_01.csv", json.dumps(wicked)[1:-1]))
    regimes = [{**story.document["regimes"][0], "where": wicked}]
    write_report(tmp_path, replace(changed_document(story, gap=gap, regimes=regimes), traces=traces))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "onerror=&quot;alert(1)&quot;" in page
    assert "<img" not in page


def test_without_temperatures_of_a_test_run_the_training_runs_are_told() -> None:
    story = named_story(test=False)
    assert story.document["gap"]["before"]["test"] is None
    assert "On the training runs the RMSE of free runs goes from" in gap_sentence(story.document)
    assert "Step by step, training runs [K]:" in summary_text(story.document)
    assert getattr(shown_run(story), "name", None) == "train_01.csv"  # its error, 2.67 K, is the largest


def test_without_matplotlib_the_page_says_how_to_get_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "matplotlib" else found(name)
    )
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    write_report(tmp_path, named_story())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<svg" not in page
    assert "pip install matplotlib" in words(page)


def test_matplotlib_is_not_there_until_a_picture_is_drawn() -> None:
    program = "import sys, edge.diagnosis.report.page; print('matplotlib' in sys.modules)"
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert out.stdout.strip() == "False"


@pytest.mark.parametrize("rows", [1, 3, 30])
@pytest.mark.parametrize("value", [None, np.nan, np.inf, 1.0])
def test_any_run_can_be_drawn(rows: int, value: float | None, recwarn: pytest.WarningsRecorder) -> None:
    series = [None if value is None else np.full(rows, value)] * 4
    inputs = {} if value is None else {"fan_on": np.full(rows, value)}
    traces = tuple(
        Trace(f"{role}.csv", role, 60.0 * np.arange(rows), *series, inputs=inputs)
        for role in ("train", "test")
    )
    drawn = pictures(Story(nothing_story().document, traces))
    assert drawn is not None
    assert bool(drawn["run"]) == (value == 1.0 and rows >= 3)
    assert drawn["residual"] == ()
    assert [str(one.message) for one in recwarn] == []


def test_of_a_long_run_the_worst_part_is_shown() -> None:
    time_s = 60.0 * np.arange(101)
    before = np.where((time_s >= 2400.0) & (time_s < 3000.0), 22.0, 20.0)
    trace = Trace("a.csv", "test", time_s, np.full(101, 20.0), before)
    part = worst_stretch(trace, 1200.0)
    assert part.time_s[-1] - part.time_s[0] == 1200.0
    assert part.residual("before").tolist().count(-2.0) == 10  # type: ignore[union-attr]  # all of them
    assert worst_stretch(trace, 6000.0) is trace


def test_a_free_run_that_runs_away_does_not_squeeze_the_picture() -> None:
    measured, away = np.linspace(20.0, 30.0, 50), np.linspace(20.0, 1e9, 50)
    low, high = limits(measured, measured + 0.1, away) or (0.0, 0.0)
    assert 19.0 < low <= 20.0 and 40.0 <= high < 42.0  # the span of 10 K once more above
    assert residual_limits(Trace("a.csv", "test", np.arange(50.0), measured, away)) == (-10.5, 0.5)
    assert limits(None, None, None) is None


def innovations(count: int, correlation: float = 0.0) -> list[Trace]:
    """Runs of white noise, or of a first-order process, with a fan that is switched at random."""
    random, found = np.random.default_rng(3), []
    for run in range(count):
        noise = random.standard_normal(200)
        for row in range(1, 200):
            noise[row] += correlation * noise[row - 1]
        noise[60:70] = np.nan
        inputs = {"fan_on": (random.random(200) < 0.5).astype(float), "temp_ambient": np.full(200, 21.0)}
        found.append(Trace(f"{run}", "train", 60.0 * np.arange(200), innovations=noise, inputs=inputs))
    return found


def test_the_cumulated_periodogram_of_white_noise_stays_in_its_band() -> None:
    for correlation, white in ((0.0, True), (0.6, False)):
        outside = 0
        for run in innovations(40, correlation):
            found = cumulated_periodogram([run])
            assert found is not None
            assert found.share[-1] == pytest.approx(1.0)
            assert found.frequency_h[-1] == pytest.approx(30.0, rel=0.02)  # half of one row a minute
            even = np.arange(1, len(found.share) + 1) / len(found.share)
            outside += int(np.abs(found.share - even).max() > found.band)
        # 5 % of 40 runs of white noise are 2; more than 7 have a chance below 1 in 1000.
        assert (outside <= 7) if white else (outside == 40)


def test_a_period_is_a_step_of_the_cumulated_periodogram() -> None:
    wave = np.sin(2.0 * np.pi * np.arange(240) / 12.0)
    found = cumulated_periodogram([Trace("a", "train", 60.0 * np.arange(240), innovations=wave)])
    assert found is not None
    assert found.frequency_h[int(np.argmax(found.share > 0.5))] == pytest.approx(5.0, rel=0.01)  # 12 min


def test_the_cross_correlation_shows_an_input_at_its_delay() -> None:
    traces = innovations(5)
    quiet, band = cross_correlations(traces)
    assert list(quiet) == ["fan_on"]  # the room does not move
    assert band == pytest.approx(1.96 / np.sqrt(5 * 190))
    assert np.mean(np.abs(quiet["fan_on"]) > band) < 0.2
    late = [
        replace(one, innovations=one.innovations + 2.0 * np.append(np.zeros(3), one.inputs["fan_on"][:-3]))
        for one in traces
    ]
    shown, _ = cross_correlations(late)
    assert int(np.argmax(shown["fan_on"])) == 3
    # 2 b with b of variance 1/4 beside noise of variance 1: 1 / sqrt(2)
    assert shown["fan_on"][3] == pytest.approx(0.707, abs=0.06)


def test_every_effect_of_the_library_has_plain_words() -> None:
    for name in EFFECTS:
        text = known_name(name)
        assert text.endswith(f" ({name})") and ":" not in text and ";" not in text, text
    assert known_name("radiative_split") == "heat that the heater radiates past the air (radiative_split)"
    assert known_name("no_such_effect") == "no_such_effect"


@pytest.mark.parametrize("name", STORIES)
def test_the_summary_has_the_facts_in_a_screenful_of_short_lines(name: str) -> None:
    text = summary_text(STORIES[name]().document, "out dir/report")
    assert " ".join(text.split()).startswith(HEADLINES[name])
    assert 6 <= len(text.splitlines()) <= 24  # of a terminal
    assert max(map(len, text.splitlines())) <= 100
    assert ("greenhouse twin adopt 'out dir/report'" in text) == (name == "named")


def test_the_summary_of_a_named_effect() -> None:
    text = summary_text(named_story().document)
    assert re.search(r"test runs +2\.87 +0\.084 +0\.085 +100 %", text)
    text = " ".join(text.split())
    assert "58 %: within 15 min of a change of the duty; there the twin gains 14.2 ± 0.9 W too much" in text
    assert "tau_h = 418 s (95 %: 402 to 435); probability 0.95" in text
    assert "these data cannot tell it from supply air that leaves before it mixes (short_circuit" in text
    assert "greenhouse experiment report/next_experiment.csv --out next_run.csv" in text


def test_headlines_count_and_join() -> None:
    document = dict(named_story().document)
    lag, fan = map(effect_name, document["effects"])
    assert headline({**document, "effects": document["effects"][:1]}) == f"One effect is missing: {lag}"
    assert headline({**document, "verdict": "unknown", "depends_on": []}).startswith(
        f"Besides {lag} and {fan}, something is missing"
    )
    bare = {**document["effects"][1], "equation": "", "alternatives": ["a", "b"]}
    assert effect_name(bare) == "fan_effectiveness, or a or b"
    assert join_names([]) == "" and join_names(["a", "b", "c"]) == "a, b and c"


def test_the_share_of_the_gap_that_is_closed() -> None:
    def gap(before: float | None, after: float | None, floor: float | None) -> dict[str, Any]:
        sides = {"before": {"test": {"rmse_k": before}}, "after": {"test": {"rmse_k": after}}}
        return {"gap": {**sides, "noise_floor": {"test": floor}}}

    assert shrink(gap(1.1, 0.2, 0.1), "test") == pytest.approx(0.9)  # 0.9 K of 1.0 K
    assert shrink(gap(0.5, 0.6, 0.1), "test") == pytest.approx(-0.25)  # worse than before
    assert shrink(gap(0.104, 0.1, 0.1), "test") is None  # no gap to close
    assert shrink(gap(1.1, 0.2, None), "test") is None
    assert shrink(gap(None, 0.2, 0.1), "test") is None


def test_steps_of_the_waterfall_have_names() -> None:
    steps = [{"effects": names} for names in ([], ["a"], ["a", "b", "c"])]
    assert step_names(steps) == ["the twin as given", "+ a", "+ b, + c"]


@pytest.mark.parametrize(
    ("errors", "scale", "begin"),
    [([640.0, 1.0, 0.2], "log", 0.12), ([6.1, 0.2], "log", 0.12), ([5.9, 0.2], "linear", 0.0),
     ([640.0, 0.0], "linear", 0.0)],
)  # fmt: skip
def test_a_gap_that_shrinks_thirtyfold_and_more_is_drawn_on_a_logarithmic_axis(
    errors: list[float], scale: str, begin: float
) -> None:
    axes = new_figure(2.0).subplots()
    assert error_axis(axes, errors) == pytest.approx(begin)
    assert axes.get_xscale() == scale
    assert axes.get_xlim()[1] > max(errors)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (number(1234.5), "1234"),
        (number(0.00081), "0.000810"),
        (number(0.0), "0.00"),
        (number(None), "–"),
        (number(1e-9), "1.00e-09"),
        (kelvin(2.871), "2.87"),
        (kelvin(0.0849), "0.085"),
        (kelvin(99.94), "99.94"),
        (kelvin(642.7), "643"),
        (percent(0.714), "71 %"),
        (percent(0.004), "< 1 %"),
        (percent(0.0), "0 %"),
        (percent(0.996), "> 99 %"),
        (percent(1.0), "100 %"),
        (plus_minus(38.1, 3.1), "38 ± 3"),
        (plus_minus(0.2, 0.3), "0.2 ± 0.3"),
        (plus_minus(2.314, 0.142), "2.31 ± 0.14"),
        (plus_minus(-5.0, None), "-5.00"),
        (nats(-0.02), "0.0"),
        (nats(812.44), "812"),
        (nats(-12.34), "-12.3"),
        (odds(0.0), "even"),
        (odds(2.302585), "10 to 1"),
        (odds(-1.0986), "1 to 3.0"),
        (odds(14.0), "more than 100 to 1"),
        (odds(-800.0), "less than 1 to 100"),
        (odds(None), "–"),
        (duration(45.0), "45 s"),
        (duration(119.0), "119 s"),
        (duration(5400.0), "90 min"),
        (duration(9000.0), "2.5 h"),
        (duration(1209600.0), "14 d"),
    ],
)
def test_numbers_as_a_person_reads_them(text: str, said: str) -> None:
    assert text == said


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_progress_rewrites_one_line_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "41")
    out, times = Terminal(), iter([0.0, 1.0, 30.0, 600.0, 900.0])
    with TerminalProgress(out, lambda: next(times)) as progress:
        progress("fit 1 of 25: wall_loss", 0.1)
        progress("bad\n\x1b[2Jname", 0.5)
        progress("", 0.75)
        progress("back to the search", 0.3)
    assert out.getvalue() == (
        "\r\x1b[K[##                  ]  10 %  fit 1 of 2"
        "\r\x1b[K[##########          ]  50 %, 30 s left "
        "\r\x1b[K[###############     ]  75 %, 3 min left"
        "\r\x1b[K[###############     ]  75 %, 5 min left"
        "\r\x1b[K"
    )


def test_progress_is_lines_in_a_file() -> None:
    out = io.StringIO()
    with TerminalProgress(out) as progress:
        progress("reads runs", 0.0)
        progress("fit 1 of 25", 0.08)
    assert out.getvalue() == "  0 % reads runs\n  8 % fit 1 of 25\n"


def test_a_stage_of_unknown_length_goes_on_and_never_ends_early() -> None:
    told: list[float] = []
    stage = Stage(lambda _, share: told.append(share), 0.2, 0.6, 5.0)
    for _ in range(40):
        stage("a fit")
    assert told[0] == 0.2
    assert told == sorted(set(told))
    assert 0.59 < told[-1] < 0.6
