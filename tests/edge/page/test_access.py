"""Links, sessions, passwords and acknowledgements, by a clock of the test's own."""

import os
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.commands import page as page_command
from edge.core.errors import DataError, RequestError
from edge.page.access import DAY_S, NEEDS, SESSION_S, Access, Role, order_problem

NOBODY = 65534


class Wall:
    """A wall clock that is set by hand."""

    def __init__(self) -> None:
        self.utc = 1e9

    def __call__(self) -> float:
        return self.utc


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.fixture
def access(tmp_path: Path, wall: Wall) -> Access:
    return Access(tmp_path / "page" / "page.db", wall)


def entered(access: Access, link: str) -> str:
    begun = access.enter(link, "a browser")
    assert begun is not None
    return begun[0]


def test_a_link_for_many_ends_with_all_its_sessions(access: Access, wall: Wall) -> None:
    link = access.make_link(Role.VIEW, "class", 7 * DAY_S, uses=None)
    sessions = [entered(access, link) for _ in range(3)]
    wall.utc += 6.9 * DAY_S
    assert all(access.visitor(secret) for secret in sessions)  # a visit does not prolong them
    wall.utc += 0.2 * DAY_S
    assert not any(access.visitor(secret) for secret in sessions)
    assert access.enter(link, "") is None


def test_a_session_of_ones_own_lives_as_long_as_it_is_visited(access: Access, wall: Wall) -> None:
    secret = entered(access, access.make_link(Role.OPERATE, "Ann", DAY_S))
    for _ in range(3):
        wall.utc += 0.9 * SESSION_S
        visitor = access.visitor(secret)
        assert visitor is not None
        assert (visitor.name, visitor.role) == ("Ann", Role.OPERATE)
    wall.utc += 1.1 * SESSION_S
    assert access.visitor(secret) is None


def test_a_link_is_void_when_its_time_is_over(access: Access, wall: Wall) -> None:
    link = access.make_link(Role.ADMIN, "Ann", 3600.0)
    wall.utc += 3601.0
    assert access.enter(link, "") is None
    assert access.enter("", "") is None


def test_a_new_password_ends_the_sessions_of_the_old_one(access: Access) -> None:
    access.set_password("Bo", Role.OPERATE, "first password")
    begun = access.log_in("Bo", "first password", "")
    assert begun is not None
    access.set_password("Bo", Role.VIEW, "second password")
    assert access.visitor(begun[0]) is None
    assert access.log_in("Bo", "first password", "") is None
    again = access.log_in("Bo", "second password", "")
    assert again is not None
    assert again[1].role is Role.VIEW
    for name, password in (("Bo", ""), ("nobody", "second password"), ("", "")):
        assert access.log_in(name, password, "") is None


@pytest.mark.parametrize(
    ("name", "password"), [("Bo", "short"), ("", "long enough"), ("\x00 ", "long enough")]
)
def test_a_name_and_a_long_password_are_needed(access: Access, name: str, password: str) -> None:
    with pytest.raises(RequestError):
        access.set_password(name, Role.VIEW, password)


def test_revoking_ends_one_session_or_all_and_every_link(access: Access) -> None:
    link = access.make_link(Role.VIEW, "class", DAY_S, uses=None)
    first, second = entered(access, link), entered(access, link)
    visitor = access.visitor(first)
    assert visitor is not None
    assert access.revoke("sessions", visitor.session) == [visitor.session]
    assert access.visitor(first) is None
    assert access.visitor(second) is not None
    assert len(access.revoke_all()) == 1
    assert access.visitor(second) is None
    assert access.enter(link, "") is None
    assert access.sessions() == []


def test_a_link_and_a_person_end_with_their_sessions_alone(access: Access) -> None:
    links = [access.make_link(Role.VIEW, name, DAY_S, uses=None) for name in ("class", "neighbours")]
    by_link = [entered(access, links[0]), entered(access, links[0]), entered(access, links[1])]
    for name in ("Bo", "Cy"):
        access.set_password(name, Role.OPERATE, "long enough")
    begun = access.log_in("Bo", "long enough", "")
    assert begun is not None
    [number] = [row["link"] for row in access.links() if row["name"] == "class"]
    assert len(access.revoke("links", number)) == 2
    assert [access.visitor(secret) is None for secret in by_link] == [True, True, False]
    assert access.enter(links[0], "") is None and access.enter(links[1], "") is not None
    assert access.revoke("people", "Bo") == [begun[1].session]
    assert access.visitor(begun[0]) is None and access.log_in("Bo", "long enough", "") is None
    assert [row["name"] for row in access.people()] == ["Cy"]
    assert access.role_of("links", number) is None and access.role_of("people", "Cy") is Role.OPERATE


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["1"], "Session 1 ended; link 1, which it came from, still works: --link 1.\n"),
        (["3"], "Session 3 ended.\n"),  # its link was for one browser
        (["4"], "Session 4 ended.\n"),
        (["--link", "1"], "Link 1 no longer works; 2 sessions ended.\n"),
        (["--link", "2"], "Link 2 no longer works; 1 session ended.\n"),
        (["--link", "3"], "Link 3 no longer works; no browser has a session by it.\n"),
        (["--person", "Bo"], "Bo can no longer log in; 1 session ended.\n"),
        ([], "All ended: 4 sessions, 3 links. Passwords still work; --person NAME ends one.\n"),
        (["9"], "there is no session 9: `greenhouse page sessions` lists sessions (revoke N), links (--link"),
        (["--link", "9"], "there is no link 9: "),
        (["--person", "Cy"], "there is no person Cy: "),
    ],
)
def test_revoke_says_what_ended_and_what_still_works(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    said: str,
) -> None:
    config, access = tmp_path / "edge.yaml", Access.of(tmp_path / "page")
    config.write_text(f"page: {{folder: {access.path.parent}}}\n")
    page = ["page", "--config", str(config)]
    links = [access.make_link(Role.VIEW, "class", DAY_S, uses) for uses in (None, 1, None)]
    for link in (links[0], links[0], links[1]):
        entered(access, link)
    monkeypatch.setattr(page_command, "ask_password", lambda: "long enough")
    assert main([*page, "person", "Bo"]) == 0
    assert access.log_in("Bo", "long enough", "a browser") is not None
    assert main([*page, "sessions"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[0] == "Bo may log in now (operate)."
    rows = [f"session {number}" for number in (4, 3, 2, 1)] + [f"link {number}" for number in (3, 2, 1)]
    assert [line.partition("  ")[0] for line in listed[1:]] == [*rows, "person"]
    assert main([*page, "revoke", *options]) == (2 if said.startswith("there") else 0)
    heard = capsys.readouterr()
    assert (heard.out or heard.err.removeprefix("greenhouse page: ")).startswith(said)


def test_the_number_of_a_link_is_not_used_again(access: Access) -> None:
    for number in (1, 2):
        access.make_link(Role.VIEW, "class", DAY_S)
        assert [row["link"] for row in access.links()] == [number]
        access.revoke("links", number)


def test_who_saw_an_alarm_first_stays(access: Access) -> None:
    access.acknowledge(5, 0, "Ann")
    access.acknowledge(5, 0, "Bo")
    access.acknowledge(4, 1, "Bo")
    assert access.who_acknowledged(5) == {(5, 0): "Ann"}
    assert access.who_acknowledged(0) == {(5, 0): "Ann", (4, 1): "Bo"}


def test_a_file_that_is_no_database_is_told(access: Access) -> None:
    access.path.parent.mkdir()
    access.path.write_bytes(b"no database " * 100)
    for call in (access.sessions, lambda: access.make_link(Role.VIEW, "x", 1.0), lambda: access.visitor("x")):
        with pytest.raises(DataError, match=r"page\.db"):
            call()


def test_a_file_that_root_makes_is_the_folders_owners(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root gives files away")
    for place in (tmp_path, *list(tmp_path.parents)[:-1]):
        place.chmod(place.stat().st_mode | 0o011)
    folder = tmp_path / "page"
    folder.mkdir(mode=0o700)
    os.chown(folder, NOBODY, NOBODY)
    access = Access.of(folder)
    access.open_to_network()
    assert (access.path.stat().st_uid, access.path.stat().st_mode & 0o777) == (NOBODY, 0o600)


def test_every_role_may_stop_and_what_is_not_listed_nobody_may() -> None:
    for role in Role:
        assert order_problem({"do": "emergency_stop"}, role) == ""
        for unlisted in ("steer", "resend", "commission", "status", "", None, ["set_mode"], {}):
            assert order_problem({"do": unlisted}, role)
    allowed = {role: {kind for kind in NEEDS if not order_problem({"do": kind}, role)} for role in Role}
    assert allowed[Role.VIEW] == {"emergency_stop"}
    assert allowed[Role.VIEW] < allowed[Role.OPERATE] < allowed[Role.ADMIN] == set(NEEDS)
