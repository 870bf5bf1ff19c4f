"""`greenhouse fleet user`: people by name and group; passwords that are asked for and never stored."""

import getpass
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.page.access import Role
from fleet.database.base import open_database
from fleet.page.people import People
from fleet.settings import DatabaseSettings

PASSWORD = "a good long one"


@pytest.fixture
def people(tmp_path: Path) -> People:
    (tmp_path / "fleet.yaml").write_text(f'database: {{url: "sqlite:///{tmp_path}/fleet.db"}}\n')
    return People(open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")))


def call(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str, password: str = PASSWORD) -> int:
    monkeypatch.setattr(getpass, "getpass", lambda prompt: password)
    given = ["fleet", "user", "--settings", str(folder / "fleet.yaml"), *words]
    monkeypatch.setattr("sys.argv", ["greenhouse", *given])
    return main(given)


def test_people_are_added_listed_and_removed(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, tmp_path, "add", "Ann", "--role", "admin") == 0
    assert call(monkeypatch, tmp_path, "add", "Ben", "--group", "north", "--role", "operate") == 0
    assert call(monkeypatch, tmp_path, "add", "Ben", "--group", "south", "--keep-password") == 0
    assert call(monkeypatch, tmp_path, "list") == 0
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["Ann", "*", "admin"],
        ["Ben", "north", "operate"],
        ["Ben", "south", "view"],
    ]
    begun = people.log_in("Ben", PASSWORD, "a browser")
    assert begun is not None
    secret, visitor = begun
    assert dict(visitor.rights) == {"north": Role.OPERATE, "south": Role.VIEW}
    assert call(monkeypatch, tmp_path, "remove", "Ben", "--group", "north") == 0
    assert people.visitor(secret) is not None
    assert call(monkeypatch, tmp_path, "remove", "Ben") == 0
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
        assert call(monkeypatch, tmp_path, *words, password=password) == 2
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
