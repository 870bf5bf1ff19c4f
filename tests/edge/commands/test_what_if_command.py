"""`greenhouse what-if`: which twin it asks, what it prints, what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from edge.__main__ import main
from edge.bundle.manifest import TWIN
from edge.config.loading import load
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import read_twin_file, write_twin_file
from edge.twin.value import Value

PACKAGED = Path("edge/models/default_bundle/twin.yaml")
OPTIONS = ("--reach", "35", "--room", "20")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A configuration without a daemon and without bundles."""
    configured(tmp_path)
    return tmp_path


def configured(folder: Path, **sections: object) -> None:
    usual = {
        "control_socket": {"path": str(folder / "control.sock")},
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
    }
    (folder / "edge.yaml").write_text(yaml.safe_dump(usual | sections))


def asked(folder: Path, *words: str) -> int:
    return main(["what-if", "--config", str(folder / "edge.yaml"), *words])


def refusal(folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert asked(folder, *words) == 2
    return capsys.readouterr().err.strip()


def own_twin(folder: Path, **geometry: float) -> None:
    file = read_twin_file(PACKAGED)
    values = {name: Value(value) for name, value in geometry.items()}
    folder.mkdir(parents=True)
    write_twin_file(replace(file, geometry={**file.geometry, **values}), folder / TWIN)


def test_the_answer_is_a_sentence_a_table_and_what_it_rests_on(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert asked(rig, *OPTIONS, "--heater-w", "150") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("With the change: Yes: 35 °C takes ")
    assert "by the packaged bundle; room 20 °C, target 35 °C, reference 24 °C" in lines
    table = {line[:42].strip(): line[42:].split("  ") for line in lines if " to " in line[42:]}
    assert {"full heat for good", "to hold the target", "a day at the reference"} <= set(table)
    assert any("packaged twin" in line for line in lines)
    assert all(len(line) < 220 for line in lines)


def test_json_is_what_the_table_says(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert asked(rig, *OPTIONS, "--heater-w", "30", "--json") == 0
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert found["question"]["change"] == {
        "heater_w": 30.0,
        "wall_factor": None,
        "wall_thickness": 1.0,
        "fan": None,
    }
    assert found["question"]["start_c"] == 20.0
    rows = {row["row"]: row for row in found["rows"]}
    never = rows["to the target at full heat"]["changed"]
    assert never == {"value": None, "low": None, "high": None, "text": "never"}
    assert rows["to the target at full heat"]["now"]["low"] > 10.0
    assert "No: " in found["verdict"]


def test_walls_by_thickness_are_walls_by_a_factor_and_heavier(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    thick = ("--walls-mm", "16", "--wall", "polycarbonate:8mm")
    tables = []
    for words in (thick, ("--wall-factor", str(0.30 / 0.34))):
        assert asked(rig, *OPTIONS, *words, "--json") == 0
        rows = json.loads(capsys.readouterr().out)["rows"]
        tables.append({row["row"]: row["changed"] for row in rows})
    for row in ("full heat for good", "to hold the target", "a day at the reference"):
        assert tables[0][row]["text"] == tables[1][row]["text"]
    slow, usual = (table["to the target at full heat"]["high"] for table in tables)
    assert slow > 1.1 * usual


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--walls-mm 16", "--walls-mm needs the present walls, --wall polycarbonate:8mm"),
        ("--walls-mm 16 --wall-factor 0.5", "say the same in two ways"),
        ("--walls-mm 16 --wall straw:80mm", "'straw' is none of"),
        ("--twin nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_a_question_that_is_not_whole_is_refused(
    rig: Path, capsys: pytest.CaptureFixture[str], words: str, reason: str
) -> None:
    assert reason in refusal(rig, capsys, *OPTIONS, *words.split())


def test_the_twin_is_the_active_bundles(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own_twin(rig / "bundles" / "2.0", heater_max_w=70.0)
    (rig / "bundles" / "roles.json").write_text(json.dumps({"active": "2.0", "on_probation": False}))
    assert asked(rig, *OPTIONS) == 0
    said = capsys.readouterr().out
    assert "of the 70 W" in said and "by bundle 2.0;" in said and "packaged twin" not in said
    shutil.rmtree(rig / "bundles" / "2.0")
    assert "twin.yaml" in refusal(rig, capsys, *OPTIONS)


def test_a_box_of_another_kind_is_not_answered_for_by_the_packaged_twin(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box = rig / "box.yaml"
    configured(rig, box={"twin": str(box)})
    box.write_text(text(BoxDescription(0.027, 40.0, "none")))
    assert "greenhouse commission" in refusal(rig, capsys, *OPTIONS)
    shutil.copy(PACKAGED, box)  # as it is once it was learned
    assert asked(rig, *OPTIONS) == 0
    assert f"by {box};" in capsys.readouterr().out
    configured(rig, bundle={"path": ""})
    assert "bundle.path is empty" in refusal(rig, capsys, *OPTIONS)
    box.write_text(text(BoxDescription(0.027, 40.0, "none")))
    assert "is still to be fitted" in refusal(rig, capsys, *OPTIONS, "--twin", str(box))


def test_the_rigs_own_limits_count(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    configured(rig, safety={"heater_max_duty": 0.5})
    assert load(rig / "edge.yaml").safety.heater_max_duty == 0.5
    assert asked(rig, *OPTIONS) == 0
    said = capsys.readouterr().out
    assert said.startswith("No: ") and "Full heat is 50% of the heater (safety.heater_max_duty)." in said
