"""The repo's example runs: what is hidden in them is named, and what the manual says of them was printed."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnosis_examples import named_story
from jsonschema import Draft202012Validator

from bench.example_diagnosis import EXAMPLE, command, standalone, with_answer
from bench.make_example_runs import NEW_BOX, RECORDINGS, SINCE
from edge.__main__ import main
from edge.diagnosis.diagnosis_file import schema
from edge.diagnosis.report.page import PAGE_NAME, write_report
from edge.formats.run_file import read_run
from edge.twin.twin_file import read_twin_file
from tests.support.simulated_runs import candidates_only

ROOT = Path(__file__).parents[2]
RUNS = ROOT / EXAMPLE
PAGE = ROOT / "docs" / "whats-missing.md"
TRANSCRIPT = ROOT / "bench" / "results" / "example_diagnosis.txt"
# What is hidden, and what stands in for it best; bench.example_diagnosis tries the whole library.
CANDIDATES = ("infiltration", "heater_lag", "wall_mass", "soil_mass", "longwave_radiation", "sensor_lag",
              "heater_efficiency")  # fmt: skip
HIDDEN = {place.partition(".")[2] for place in SINCE if place.startswith("effects.")}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The manual's command, without pictures, and with fewer candidates."""
    folder = tmp_path_factory.mktemp("example") / "report"
    train = [str(path) for path in sorted(RUNS.glob("train_*.csv"))]
    words = ["twin", "diagnose", *train, "--test", str(RUNS / "test_1.csv")]
    words += ["--twin", str(RUNS / "twin.yaml"), "--out", str(folder), "--json-only"]
    with candidates_only(*CANDIDATES):
        assert main(words) == 0
    return folder


@pytest.fixture(scope="module")
def document(report: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((report / "diagnosis.json").read_text(encoding="utf-8"))
    Draft202012Validator(schema()).validate(found)
    return found


def test_what_is_hidden_in_the_example_is_named_and_nothing_else(document: dict[str, Any]) -> None:
    assert {"infiltration", "heater_lag"} == HIDDEN
    assert document["verdict"] == "named"
    assert {effect["name"] for effect in document["effects"]} == HIDDEN


def test_the_gap_of_the_held_out_run_is_gone(document: dict[str, Any]) -> None:
    gap = document["gap"]
    before, after = (gap[when]["test"]["rmse_k"] for when in ("before", "after"))
    assert (before - after) / (before - gap["noise_floor"]["test"]) > 0.9  # the target of the benchmark


def test_the_new_twin_has_what_was_known_and_what_was_hidden(report: Path) -> None:
    before, after = (read_twin_file(path) for path in (RUNS / "twin.yaml", report / "twin.yaml"))
    assert not HIDDEN & set(before.effects)
    assert set(after.effects) == set(before.effects) | HIDDEN


def test_the_twin_of_the_example_is_of_the_box_when_it_was_new() -> None:
    known = {place.partition(".")[2] for place in NEW_BOX if place.startswith("effects.")}
    assert known <= set(yaml.safe_load((RUNS / "twin.yaml").read_text(encoding="utf-8"))["effects"])


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda recording: recording.name)
def test_a_run_of_the_example_is_as_it_is_recorded(recording: Any) -> None:
    run = read_run(RUNS / recording.name)
    assert len(run) == recording.minutes + 1
    assert (run.facts["role"], run.facts["seed"]) == (recording.role, str(recording.seed))
    assert not run.columns["heater_duty"][:10].any()  # the rest at its beginning


def test_the_manual_shows_the_command_that_is_played_through() -> None:
    shown = re.sub(r" \\\n +", " ", PAGE.read_text(encoding="utf-8"))
    assert command(EXAMPLE / "twin.yaml", Path("out/report")) in shown


def test_the_manual_shows_what_the_command_printed() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert with_answer(page, TRANSCRIPT.read_text(encoding="utf-8")) == page


def test_an_answer_replaces_the_one_before() -> None:
    mark = "<!-- diagnosis -->\n```\n"
    assert with_answer(f"a\n{mark}old\n```\nb\n", "$ one\nnew\nlines\n\n$ two\nmore") == (
        f"a\n{mark}new\nlines\n```\nb\n"
    )
    with pytest.raises(ValueError, match="no block"):
        with_answer("a", "$ one\nnew")


def test_pictures_of_the_manual_need_no_page(tmp_path: Path) -> None:
    write_report(tmp_path, named_story())
    page = (tmp_path / PAGE_NAME).read_text(encoding="utf-8").replace("test_01.csv", "test_1.csv")
    for text in standalone(page).values():
        assert text.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
        assert "var(--" not in text and "currentColor" not in text


def test_a_report_without_the_picture_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no picture that begins with 'test_1.csv'"):
        standalone('<svg role="img" aria-label="another" viewBox="0 0 1 1"></svg>')
