"""`greenhouse bundle`: what it prints, with a daemon and without one."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from bundles import Workshop, answering, configured_rig

from edge.__main__ import main
from edge.bundle import signature, store
from edge.bundle.keeper import BundleKeeper
from edge.bundle.predictors import loader
from edge.bundle.store import BundleStore


@pytest.fixture
def workshop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workshop:
    return configured_rig(tmp_path, monkeypatch)


@pytest.fixture
def daemon(workshop: Workshop) -> Iterator[BundleKeeper]:
    place = BundleStore(workshop.folder / "rig" / "bundles", workshop.trusted, loader(60.0))
    with answering(place, workshop.folder) as keeper:
        yield keeper


def bundle(workshop: Workshop, *words: object) -> int:
    return main(["bundle", "--config", str(workshop.folder / "edge.yaml"), *map(str, words)])


def test_a_bundle_goes_its_way_without_a_daemon(
    workshop: Workshop, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = workshop.archive("1.0")
    assert bundle(workshop, "verify", archive) == 0
    assert "1.0 of 2026-07-01T12:00:00Z, 60 s steps, models arx, pbm" in capsys.readouterr().out
    assert bundle(workshop, "install", archive) == 0
    assert capsys.readouterr().out == "bundle 1.0 is installed\nactive: packaged; shadow: 1.0\n"
    assert bundle(workshop, "activate") == 0
    assert capsys.readouterr().out == "active, on probation: 1.0; previous: packaged\n"
    assert bundle(workshop, "mark-good") == 0
    assert capsys.readouterr().out == "active: 1.0; previous: packaged\n"
    assert bundle(workshop, "list") == 0
    lines = [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    assert lines == [["packaged", "previous"], ["1.0", "active"]]
    assert bundle(workshop, "rollback") == 0
    assert capsys.readouterr().out == "active: packaged\n"


def test_a_running_daemon_is_asked_and_has_it_when_the_command_ends(
    workshop: Workshop, daemon: BundleKeeper, capsys: pytest.CaptureFixture[str]
) -> None:
    assert daemon.serving.active.name == "packaged"
    assert bundle(workshop, "install", workshop.archive("1.0")) == 0
    assert daemon.serving.rival.name == "1.0"
    assert bundle(workshop, "activate", "1.0") == 0
    assert daemon.serving.active.name == "1.0"
    assert "active: 1.0, on probation; beside it: packaged (the daemon has it)" in capsys.readouterr().out
    assert bundle(workshop, "activate", "1.0") == 2
    assert capsys.readouterr().err == "greenhouse bundle: bundle 1.0 is active already\n"


def test_what_is_refused_is_told_in_one_line_and_names_the_file(
    workshop: Workshop, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = workshop.archive("1.0", minimum_software="0.1.0")
    for trusted in workshop.trusted.iterdir():
        trusted.unlink()
    assert bundle(workshop, "install", archive) == 2
    assert capsys.readouterr().err == (
        f"greenhouse bundle: {archive}: the signature is by none of the 0 trusted keys (none)\n"
    )
    assert bundle(workshop, "verify", workshop.folder / "nothing.zip") == 2
    assert capsys.readouterr().err.endswith("nothing.zip: No such file or directory\n")


def test_a_bundle_for_another_step_than_the_rigs_is_refused(
    workshop: Workshop, capsys: pytest.CaptureFixture[str]
) -> None:
    with (workshop.folder / "edge.yaml").open("a") as file:
        file.write("control: {step_s: 30}\n")
    assert bundle(workshop, "install", workshop.archive("1.0")) == 2
    assert "sample_s: made for 60 s, control.step_s is 30" in capsys.readouterr().err


def test_list_tells_what_can_not_be_used(workshop: Workshop, capsys: pytest.CaptureFixture[str]) -> None:
    bundle(workshop, "install", workshop.archive("1.0"))
    (workshop.folder / "rig" / "bundles" / "1.0" / "twin.yaml").write_text("")
    capsys.readouterr()
    assert bundle(workshop, "list") == 0
    assert "can't be used: bundle 1.0: twin.yaml: has 0 bytes" in capsys.readouterr().out


def test_other_keys_are_for_verify_alone(workshop: Workshop, tmp_path: Path) -> None:
    shutil.move(workshop.trusted / "signing.pub", tmp_path / "kept.pub")
    (tmp_path / "mine").mkdir()
    shutil.move(tmp_path / "kept.pub", tmp_path / "mine")
    archive = workshop.archive("1.0")
    assert bundle(workshop, "verify", archive) == 2
    assert bundle(workshop, "verify", archive, "--keys", tmp_path / "mine") == 0
    with pytest.raises(SystemExit):
        bundle(workshop, "install", archive, "--keys", tmp_path / "mine")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_what_root_installs_belongs_to_the_daemons_user(
    workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge.commands.bundle.Prover", lambda *_: None)  # Python may be root's
    b"".decode("cp437")  # loaded while it can be: zipfile asks for it
    for folder in [tmp_path, *list(tmp_path.parents)[:-1]]:  # a user like the daemon's must reach the place
        if folder.stat().st_mode & 0o005 != 0o005:
            folder.chmod(folder.stat().st_mode | 0o005)
    (tmp_path / "rig").mkdir()
    os.chown(tmp_path / "rig", 12345, 12346)
    assert bundle(workshop, "install", workshop.archive("1.0")) == 0
    places = [tmp_path / "rig" / "bundles", *(tmp_path / "rig" / "bundles").rglob("*")]
    assert len(places) == 10  # store, lock, roles.json, admitted.json, the bundle's folder, five files
    assert {(place.stat().st_uid, place.stat().st_gid) for place in places} == {(12345, 12346)}
    assert (os.geteuid(), os.getegid()) == (0, 0)


def test_the_packaged_bundle_is_where_the_store_looks() -> None:
    assert store.PACKAGED_FOLDER.parent == signature.PACKAGED_KEY.parent
