"""`greenhouse commission`: what it needs before hours are spent, what it makes, what it refuses."""

import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from edge.__main__ import main
from edge.app import commission
from edge.app.commission import Expectation
from edge.bundle.sign import generate_key
from edge.commands.commission import describe, keep, save_run
from edge.config.loading import load
from edge.formats.run_file import read_run
from edge.models.arx_file import read_arx
from edge.state.store import STANDING, restore
from edge.twin.new_file import BoxDescription, text
from edge.twin.twin_file import read_twin_file
from edge.twin.value import Value

pytestmark = pytest.mark.slow

TWIN = Path("training/results/paper_case/interpolation/twin.yaml").resolve()
GOOD = Expectation(2.0, 40.2, 21.0, 40.0, 22.0, 0.2, 5.0)


@dataclass(frozen=True)
class FoundModel:
    model: object = field(default_factory=read_arx)


@dataclass(frozen=True)
class FoundBox:
    """A result as `learn` gives it, without the minutes that a diagnosis takes."""

    refusals: tuple[str, ...] = ()
    names: tuple[str, ...] = ("heater_lag",)
    expectation: Expectation = GOOD
    twin: object = field(default_factory=lambda: read_twin_file(TWIN))
    arx: object = field(default_factory=FoundModel)
    better: tuple[str, float] | None = None
    doubts: tuple[str, ...] = ()


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """A configuration with a key of its own, in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "keys").mkdir()
    public = generate_key(tmp_path / "rig.pem")
    public.rename(tmp_path / "keys" / public.name)
    (tmp_path / "box.yaml").write_text(text(BoxDescription(0.15, 100.0, "exhaust", 68.0)))
    (tmp_path / "edge.yaml").write_text(
        yaml.safe_dump(
            {
                "state_file": str(tmp_path / "state.json"),
                "control_socket": {"path": str(tmp_path / "control.sock")},
                "history": {"path": str(tmp_path / "history.db")},
                "box": {"twin": str(tmp_path / "box.yaml")},
                "bundle": {
                    "path": str(tmp_path / "bundles"),
                    "trusted_keys": str(tmp_path / "keys"),
                    "signing_key": str(tmp_path / "rig.pem"),
                },
            }
        )
    )
    return tmp_path


def commissioned(*words: str) -> int:
    return main(["commission", "--config", "edge.yaml", *words])


def run_file(folder: Path, minutes: int = 30) -> Path:
    rows = [f"{10 * k},{22 + 0.01 * k:.2f},21.0,{(k // 30) % 2},0" for k in range(6 * minutes)]
    path = folder / "old.csv"
    path.write_text("\n".join(["time_s,temp_air_c,temp_ambient_c,heater_duty,fan_on", *rows]) + "\n")
    return path


def test_a_box_that_is_good_enough_gets_its_bundle_and_its_controller(rig, monkeypatch, capsys):
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    assert commissioned("--from-run", str(run_file(rig)), "--out", "found") == 0
    said = capsys.readouterr().out
    assert "2.0 h of full heat reach 40 °C" in said and "free runs are off by 0.20 K" in said
    settings = load(rig / "edge.yaml")
    roles = yaml.safe_load(next((rig / "bundles").glob("roles*.json")).read_text())
    assert str(roles["active"]).endswith("-commissioned")
    assert restore(STANDING, settings).operation.controller == "MPC-Twin-P"
    assert read_twin_file(rig / "found" / "twin.yaml").to_fit() == []
    assert read_twin_file(rig / "box.yaml").to_fit() == []  # safety knows the box now
    assert read_twin_file(rig / "box.yaml.before").to_fit() != []


def test_no_more_is_promised_than_the_tests_have_seen():
    found = FoundBox()
    assert "full heat reach 40 °C;" in "\n".join(describe(found))
    found = replace(found, expectation=replace(GOOD, seen_c=36.6, fanned_c=math.nan))
    said = "\n".join(describe(found))
    assert "full heat reach more than 37 °C, the warmest of these tests;" in said
    assert "fan alone" not in said


def test_a_model_that_predicts_better_is_told_and_refuses_nothing():
    said = "\n".join(describe(replace(FoundBox(), better=("ARX 2", 0.1))))
    assert "ARX 2 is off by 0.10 K: the twin lacks something" in said and "refused" not in said
    assert "lacks" not in "\n".join(describe(FoundBox()))


def test_what_is_odd_is_told_and_refuses_nothing():
    said = "\n".join(describe(replace(FoundBox(), doubts=("the fan is odd: is that figure right?",))))
    assert "the fan is odd: is that figure right?" in said and "refused" not in said


def test_a_box_that_was_learned_is_learned_anew_from_its_description(rig, monkeypatch):
    starts = []
    monkeypatch.setattr(commission, "learn", lambda run, start, *more: starts.append(start) or FoundBox())
    for out in ("first", "second"):
        assert commissioned("--from-run", str(run_file(rig)), "--out", out, "--only-learn") == 0
    (rig / "box.yaml.before").write_bytes((rig / "box.yaml").read_bytes())
    (rig / "box.yaml").write_bytes(TWIN.read_bytes())
    assert commissioned("--from-run", str(run_file(rig)), "--out", "third", "--only-learn") == 0
    assert [bool(start.to_fit()) for start in starts] == [True, True, True]


def test_a_description_that_setup_wrote_anew_replaces_the_one_beside_it(tmp_path):
    place, before = tmp_path / "twin.yaml", tmp_path / "twin.yaml.before"
    before.write_text(text(BoxDescription(0.15, 100.0, "none")))
    place.write_text(text(BoxDescription(0.03, 40.0, "none")))
    for _ in range(2):  # the second time a learned twin is in its place, which describes no box
        keep(read_twin_file(TWIN), place)
        assert read_twin_file(before).geometry["heater_max_w"].value == 40.0


def test_what_is_refused_says_why_and_changes_nothing(rig, monkeypatch, capsys):
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox(refusals=("the air moved by 0.3 K",)))
    assert commissioned("--from-run", str(run_file(rig)), "--out", "found") == 1
    said = capsys.readouterr().out
    assert "refused: the air moved by 0.3 K" in said and "not commissioned" in said
    assert not (rig / "bundles").exists() and not (rig / "state.json").exists()


def test_only_learn_needs_no_key_and_activates_nothing(rig, monkeypatch):
    (rig / "edge.yaml").write_text((rig / "edge.yaml").read_text().replace("signing_key", "#"))
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    assert commissioned("--only-learn", "--from-run", str(run_file(rig)), "--out", "found") == 0
    assert not (rig / "bundles").exists()


def refused(capsys, *words: str) -> str:
    assert commissioned(*words) != 0
    return capsys.readouterr().err


def test_a_missing_key_is_told_before_the_tests(rig, capsys):
    config = yaml.safe_load((rig / "edge.yaml").read_text())
    del config["bundle"]["signing_key"]
    (rig / "edge.yaml").write_text(yaml.safe_dump(config))
    assert "no key to sign with" in refused(capsys)


def test_a_box_that_nobody_described_is_told(rig, capsys):
    config = yaml.safe_load((rig / "edge.yaml").read_text())
    del config["box"]
    (rig / "edge.yaml").write_text(yaml.safe_dump(config))
    assert "greenhouse setup" in refused(capsys)


def test_a_few_minutes_are_too_little(rig, capsys):
    said = refused(capsys, "--from-run", str(run_file(rig, minutes=5)), "--out", "found")
    assert "5 min are recorded" in said


def test_a_recording_is_never_written_over(rig, capsys):
    (rig / "found").mkdir()
    (rig / "found" / "run.csv").write_text("precious")
    assert "--from-run found/run.csv learns from it" in refused(capsys, "--out", "found")
    assert (rig / "found" / "run.csv").read_text() == "precious"


def test_the_tests_run_on_a_virtual_board(rig, monkeypatch, capsys):
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    assert commissioned("--virtual", "--minutes", "20", "--twin", "box.yaml", "--out", "found") == 0
    said = capsys.readouterr().out
    assert "20 min left" in said and "first heat" in said and "coast" in said
    rows = (rig / "found" / "run.csv").read_text().count("\n")
    assert rows > 100


def test_a_broken_state_is_not_written_over(rig, monkeypatch, capsys):
    (rig / "state.json").write_text("{broken")
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    said = refused(capsys, "--from-run", str(run_file(rig)), "--out", "found")
    assert "greenhouse controller MPC-Twin-P" in said
    assert (rig / "state.json").read_text() == "{broken"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_the_daemons_user_can_read_the_state_that_root_began(rig, monkeypatch, capsys):
    for folder in [rig, *list(rig.parents)[:-1]]:  # a user like the daemon's must reach the place
        folder.chmod(folder.stat().st_mode | 0o005)
    (rig / "var").mkdir()
    os.chown(rig / "var", 12345, 12346)
    config = yaml.safe_load((rig / "edge.yaml").read_text())
    (rig / "edge.yaml").write_text(yaml.safe_dump(config | {"state_file": str(rig / "var" / "state.json")}))
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    before = os.umask(0o077)
    try:
        assert commissioned("--from-run", str(run_file(rig)), "--out", "found") == 0
    finally:
        os.umask(before)
    state = (rig / "var" / "state.json").stat()
    assert (state.st_uid, state.st_gid) == (12345, 12346)


def test_a_heater_that_warms_nothing_is_refused_before_any_fit(rig, capsys):
    path = run_file(rig)
    rows = path.read_text().splitlines()
    flat = [rows[0], *(",".join([row.split(",")[0], "21.5", *row.split(",")[2:]]) for row in rows[1:])]
    path.write_text("\n".join(flat) + "\n")
    said = refused(capsys, "--from-run", str(path), "--out", "found")
    assert "the air moved by 0.0 K" in said and "not connected" in said


def test_a_heater_that_warms_little_is_refused_with_the_time_that_may_do(rig, capsys):
    path = run_file(rig)
    rows = path.read_text().splitlines()
    flat = [rows[0]]
    for k, row in enumerate(rows[1:]):
        cells = row.split(",")
        flat.append(",".join([cells[0], f"{21.5 + 0.006 * k:.2f}", *cells[2:]]))
    path.write_text("\n".join(flat) + "\n")
    said = refused(capsys, "--from-run", str(path), "--out", "found")
    assert "the air moved by 1.1 K" in said and "tests of 60 minutes may do" in said


def without_room(folder: Path, minutes: int):
    """A recording of a rig that has no room sensor."""
    path = run_file(folder, minutes)
    rows = [row.split(",") for row in path.read_text().splitlines()]
    path.write_text(
        "# temp_ambient_c: none\n" + "\n".join(",".join(row[:2] + row[3:]) for row in rows) + "\n"
    )
    return read_run(path)


def test_a_recording_without_a_room_sensor_is_read_again_and_gone_on_with(tmp_path):
    path = tmp_path / "run.csv"
    save_run(path, None, without_room(tmp_path, 20))
    whole = save_run(path, read_run(path), without_room(tmp_path, 30))
    again = read_run(path)
    assert len(whole) == len(again) == 6 * 50 and "temp_ambient_c" not in again.columns


def test_a_room_sensor_that_came_later_is_known_from_then_on(tmp_path):
    path = tmp_path / "run.csv"
    save_run(path, without_room(tmp_path, 20), read_run(run_file(tmp_path, 30)))
    room = read_run(path).columns["temp_ambient_c"]
    assert np.isnan(room[:120]).all() and (room[120:] == 21.0).all()


def test_tests_that_are_complete_are_not_gone_on_with(rig, capsys):
    (rig / "found").mkdir()
    run_file(rig, minutes=120).rename(rig / "found" / "run.csv")
    assert "has 120 min already" in refused(capsys, "--go-on", "found")


def test_the_rest_of_tests_that_ended_early_is_recorded_behind_them(rig, monkeypatch, capsys):
    (rig / "found").mkdir()
    run_file(rig, minutes=25).rename(rig / "found" / "run.csv")
    seen = []
    monkeypatch.setattr(commission, "learn", lambda run, *more: seen.append(run) or FoundBox())
    assert commissioned("--virtual", "--go-on", "found", "--minutes", "30", "--twin", "box.yaml") == 0
    assert len(seen[0]) == 6 * 30 and "5 min left" in capsys.readouterr().out
    assert np.diff(seen[0].columns["time_s"])[149] > 60.0


def test_tests_that_a_stop_has_ended_are_not_learned_from_at_once(rig, monkeypatch, capsys):
    run = read_run(run_file(rig))
    stopped = replace(run, facts={"stopped": "emergency stop"})
    monkeypatch.setattr("edge.commands.commission._record", lambda *given: stopped)
    said = refused(capsys, "--out", "found")
    assert "emergency stop" in said and "--go-on found records the rest" in said


def test_a_running_daemon_is_asked_for_the_planner(rig, monkeypatch, capsys):
    asked, refusals = [], [{"ok": False, "error": "not yet"}]
    monkeypatch.setattr(
        "edge.commands.commission.request",
        lambda socket, message: asked.append(message) or (refusals.pop() if refusals else {"ok": True}),
    )
    monkeypatch.setattr("edge.commands.commission.CHOSEN_LOOK_S", 0.0)
    monkeypatch.setattr(commission, "learn", lambda *given: FoundBox())
    assert commissioned("--from-run", str(run_file(rig)), "--out", "found") == 0
    assert asked == [{"do": "set_controller", "name": "MPC-Twin-P"}] * 2
    assert "MPC-Twin-P controls\n" in capsys.readouterr().out
    assert not (rig / "state.json").exists()  # the daemon's own


@dataclass(frozen=True)
class FoundTwins:
    """A diagnosis as far as the choice of the twin goes."""

    test_k: dict[str, float]
    adopted: object = field(default_factory=lambda: read_twin_file(TWIN))

    @property
    def simple_twins(self) -> dict[str, object]:
        return {"heater lag": replace(self.adopted, effects={"wall_loss": {"UA": Value(3.0)}})}


@pytest.mark.parametrize(
    ("simple_k", "limit_k", "is_taken"),
    [(0.24, 1.0, True), (0.26, 1.0, False), (0.39, 0.45, True), (0.41, 0.45, False)],
)
def test_a_simple_twin_is_taken_if_it_halves_the_error_or_makes_it_small_enough(simple_k, limit_k, is_taken):
    found = FoundTwins({"after": 0.5, "heater lag": simple_k, "ARX 2": 0.1})
    twin, error_k = commission.chosen_twin(found, limit_k)
    assert (set(twin.effects) == {"wall_loss"}) == is_taken
    assert error_k == (simple_k if is_taken else 0.5)
    assert not is_taken or twin.provenance["after"] == {"test": {"rmse_k": simple_k}}


@pytest.mark.parametrize(("arx_k", "better"), [(0.39, ("ARX 2", 0.39)), (0.41, None)])
def test_a_model_is_better_if_it_is_clearly_so(arx_k, better):
    found = FoundTwins({"before": 0.1, "after": 0.5, "heater lag": 0.45, "ARX 2": arx_k})
    assert commission.better_model(found, 0.5) == better
