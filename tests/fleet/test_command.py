"""`greenhouse fleet`: found beside the daemon's commands, and what it says where it can do nothing."""

import getpass
from datetime import datetime
from pathlib import Path

import pytest
from bundles import Workshop
from sqlalchemy.orm import Session

from edge.__main__ import main
from edge.page.access import Role
from fleet.commands.work import seconds_until
from fleet.database.base import open_database
from fleet.database.tables import BundleRollout, FleetRig
from fleet.page.people import People
from fleet.settings import DatabaseSettings
from tests.support.held_rollout import add_held_rollout

PASSWORD = "a good long one"


def settings_file(folder: Path, text: str = "") -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text or f'database: {{url: "sqlite:///{folder}/fleet.db"}}\n')
    return path


def call(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["greenhouse", "fleet", *words])
    return main(["fleet", *words])


def test_rigs_are_listed_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = settings_file(tmp_path)
    with Session(open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))) as session:
        for name, air in (("tent-2", 21.26), ("tent-1", None)):
            session.add(
                FleetRig(name=name, kind="tent", first_utc=1.0, last_utc=2.0, state={"temp_air_c": air})
            )
        session.commit()
    assert call(monkeypatch, "rigs", "--settings", str(path)) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["tent-1", "away", "tent", "no", "air", "temperature"]
    assert second.split() == ["tent-2", "away", "tent", "21.3", "°C"]


def test_a_wrong_key_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = settings_file(tmp_path, "database: {url: 'mysql://x'}\nnumbers: {ulr: 'http://x'}\n")
    assert call(monkeypatch, "rigs", "--settings", str(path)) == 2
    said = capsys.readouterr().err
    assert "database.url: 'mysql://x' does not match" in said
    assert "numbers: unknown key 'ulr'" in said


def test_a_package_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sqlalchemy", None)
    monkeypatch.delitem(__import__("sys").modules, "fleet.commands.lists", raising=False)
    monkeypatch.delitem(__import__("sys").modules, "fleet.database.base", raising=False)
    assert call(monkeypatch, "rigs", "--settings", str(settings_file(tmp_path))) == 2
    assert "pip install 'greenhouse-twin[fleet]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("at", "now", "hours"), [((3, 0), "02:00", 1.0), ((3, 0), "03:00", 24.0), ((3, 0), "04:30", 22.5)]
)
def test_the_next_night_begins_at_its_time(at: tuple[int, int], now: str, hours: float) -> None:
    moment = datetime.strptime(f"2026-01-31 {now}", "%Y-%m-%d %H:%M")
    assert seconds_until(at, moment) == 3600.0 * hours


def test_a_time_that_is_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "work", "--at", "25:00", "--settings", str(settings_file(tmp_path))) == 2
    assert "--at: '25:00' is no time like 03:00" in capsys.readouterr().err


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


def call_rollout(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    said = ["fleet", "rollout", *map(str, words)]
    monkeypatch.setattr("sys.argv", ["greenhouse", *said])
    return main(said)


def test_a_rollout_is_begun_shown_and_stopped(
    place: tuple[Workshop, Path, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    workshop, path, url = place
    assert call_rollout(monkeypatch, "start", workshop.archive("2.0"), "--settings", path) == 0
    assert "rollout 1 begins" in capsys.readouterr().out
    assert call_rollout(monkeypatch, "--settings", path, "status", "--rigs") == 0
    assert capsys.readouterr().out == "rollout 1: bundle 2.0 is running\n"
    assert call_rollout(monkeypatch, "go-on", "1", "--settings", path) == 2
    assert "wave 0 has not begun: only one that is held can go on" in capsys.readouterr().err
    assert call_rollout(monkeypatch, "stop", "1", "--why", "too early", "--settings", path) == 0
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
    assert call_rollout(monkeypatch, "go-on", "2", "--settings", path) == 0
    assert call_rollout(monkeypatch, "status", "--rigs", "--settings", path) == 0
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
    assert call_rollout(monkeypatch, "start", broken, "--settings", path) == 2
    assert "broken.zip: no bundle archive, or damaged" in capsys.readouterr().err
    assert call_rollout(monkeypatch, "stop", "7", "--settings", path) == 2
    assert "there is no rollout 7" in capsys.readouterr().err


@pytest.fixture
def people(tmp_path: Path) -> People:
    (tmp_path / "fleet.yaml").write_text(f'database: {{url: "sqlite:///{tmp_path}/fleet.db"}}\n')
    return People(open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")))


def call_user(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str, password: str = PASSWORD) -> int:
    monkeypatch.setattr(getpass, "getpass", lambda prompt: password)
    given = ["fleet", "user", "--settings", str(folder / "fleet.yaml"), *words]
    monkeypatch.setattr("sys.argv", ["greenhouse", *given])
    return main(given)


def test_people_are_added_listed_and_removed(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call_user(monkeypatch, tmp_path, "add", "Ann", "--role", "admin") == 0
    assert call_user(monkeypatch, tmp_path, "add", "Ben", "--group", "north", "--role", "operate") == 0
    assert call_user(monkeypatch, tmp_path, "add", "Ben", "--group", "south", "--keep-password") == 0
    assert call_user(monkeypatch, tmp_path, "list") == 0
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["Ann", "*", "admin"],
        ["Ben", "north", "operate"],
        ["Ben", "south", "view"],
    ]
    begun = people.log_in("Ben", PASSWORD, "a browser")
    assert begun is not None
    secret, visitor = begun
    assert dict(visitor.rights) == {"north": Role.OPERATE, "south": Role.VIEW}
    assert call_user(monkeypatch, tmp_path, "remove", "Ben", "--group", "north") == 0
    assert people.visitor(secret) is not None
    assert call_user(monkeypatch, tmp_path, "remove", "Ben") == 0
    assert people.visitor(secret) is None
    assert people.log_in("Ben", PASSWORD, "a browser") is None


def test_what_cannot_be_is_said(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, password, reason in (
        (("add", "Ann"), "short", "8 characters"),
        (("add", "Ann", "--keep-password"), PASSWORD, "has no password yet"),
        (("add", "Ann", "--group", "a b"), PASSWORD, "--group"),
        (("add", " "), PASSWORD, "a name is needed"),
        (("remove", "Nobody"), PASSWORD, "Nobody has no role"),
    ):
        assert call_user(monkeypatch, tmp_path, *words, password=password) == 2
        assert reason in capsys.readouterr().err
    assert people.rights() == []


def test_neither_passwords_nor_secrets_are_in_the_database(people: People, tmp_path: Path) -> None:
    people.add("Ann", "*", Role.VIEW, PASSWORD)
    begun = people.log_in("Ann", PASSWORD, "a browser")
    assert begun is not None
    people.engine.dispose()
    stored = b"".join(path.read_bytes() for path in tmp_path.glob("fleet.db*"))
    assert b"a browser" in stored
    assert PASSWORD.encode() not in stored
    assert begun[0].encode() not in stored


def test_a_session_ends_without_a_visit_and_lasts_with_one(tmp_path: Path) -> None:
    now = [1.7e9]
    people = People(open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")), utc=lambda: now[0])
    people.add("Ann", "*", Role.VIEW, PASSWORD)
    begun = people.log_in("Ann", PASSWORD, "a browser")
    assert begun is not None
    for days in (20, 20, 20):
        now[0] += days * 86400
        assert people.visitor(begun[0]) is not None
    now[0] += 31 * 86400
    assert people.visitor(begun[0]) is None
    assert people.sessions() == []
