"""`greenhouse fleet rollout`: begun, shown and stopped by a person."""

from pathlib import Path

import pytest
from bundles import Workshop
from sqlalchemy.orm import Session

from edge.__main__ import main
from fleet.database.base import open_database
from fleet.database.bundles import BundleRollout
from fleet.database.rigs import FleetRig
from fleet.settings import DatabaseSettings
from tests.support.held_rollout import add_held_rollout


@pytest.fixture
def place(tmp_path: Path) -> tuple[Workshop, Path, str]:
    workshop, url = Workshop(tmp_path), f"sqlite:///{tmp_path}/fleet.db"
    with Session(open_database(DatabaseSettings(url=url))) as session, session.begin():
        session.add(FleetRig(name="tent-1", kind="tent", first_utc=1.0, last_utc=2.0, is_online=True))
    path = tmp_path / "fleet.yaml"
    path.write_text(
        f'database: {{url: "{url}"}}\n'
        f"rollout: {{address: http://fleet.example/b, trusted_keys: {workshop.trusted}}}\n"
    )
    return workshop, path, url


def call(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    said = ["fleet", "rollout", *map(str, words)]
    monkeypatch.setattr("sys.argv", ["greenhouse", *said])
    return main(said)


def test_a_rollout_is_begun_shown_and_stopped(
    place: tuple[Workshop, Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    workshop, path, url = place
    assert call(monkeypatch, "start", workshop.archive("2.0"), "--settings", path) == 0
    assert "rollout 1 begins" in capsys.readouterr().out
    assert call(monkeypatch, "--settings", path, "status", "--rigs") == 0
    assert capsys.readouterr().out == "rollout 1: bundle 2.0 is running\n"
    assert call(monkeypatch, "go-on", "1", "--settings", path) == 2
    assert "wave 0 has not begun: only one that is held can go on" in capsys.readouterr().err
    assert call(monkeypatch, "stop", "1", "--why", "too early", "--settings", path) == 0
    with Session(open_database(DatabaseSettings(url=url))) as session:
        rollout = session.get_one(BundleRollout, 1)
        assert (rollout.state, rollout.why) == ("stopped", "too early")


def test_a_held_wave_is_shown_with_its_figures_and_let_go_on(
    place: tuple[Workshop, Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, path, url = place
    with Session(open_database(DatabaseSettings(url=url))) as session, session.begin():
        for version in ("1.0", "2.0"):
            rollout = add_held_rollout(session, 1.8e9, {"tent-1": "tent"}, version=version, unsure=["tent"])
            rollout.state = "stopped" if version == "1.0" else "running"
    assert call(monkeypatch, "go-on", "2", "--settings", path) == 0
    assert call(monkeypatch, "status", "--rigs", "--settings", path) == 0
    figures = (
        "    tent             +6.2% cost over 120 blocks, evidence of harm 1.8, of no harm 4.1\n"
        "  tent-1                   wave 1 active\n"
    )
    assert capsys.readouterr().out == (
        "rollout 2: wave 1 has passed\n"
        "rollout 1: bundle 1.0 is stopped\n"
        f"  wave 1: 1 rigs, held: not shown to be within 10%: tent\n{figures}"
        "rollout 2: bundle 2.0 is running\n"
        f"  wave 1: 1 rigs, passed: a person let it go on; not shown to be within 10%: tent\n{figures}"
    )


def test_what_cannot_be_is_said_in_a_line(
    place: tuple[Workshop, Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    workshop, path, _ = place
    broken = workshop.folder / "broken.zip"
    broken.write_bytes(b"PK nothing")
    assert call(monkeypatch, "start", broken, "--settings", path) == 2
    assert "broken.zip: no bundle archive, or damaged" in capsys.readouterr().err
    assert call(monkeypatch, "stop", "7", "--settings", path) == 2
    assert "there is no rollout 7" in capsys.readouterr().err
