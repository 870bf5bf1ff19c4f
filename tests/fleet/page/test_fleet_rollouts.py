"""Rollouts on the fleet's page: who sees which, who decides about one, and what the second to decide gets."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from fleet_pages import FleetPageOfTest, fleet_page
from requests import Response
from sqlalchemy.orm import Session

from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.tables import BundleRollout, RolloutRig, RolloutWave
from fleet.page.routes import SHOWN_MAX
from fleet.rollout.overview import COMPLAINTS_MAX
from tests.support.held_rollout import SAFE, UNSURE, add_held_rollout
from tests.support.page_process import Client

NONE_HERE = "there is no such rollout in your groups"
EVIL = '<img src=x onerror="alert(1)">'


@pytest.fixture
def page(tmp_path: Path) -> Iterator[FleetPageOfTest]:
    with fleet_page(tmp_path) as running:
        yield running


def begin(page: FleetPageOfTest, group: str = "", count: int = 2, kind: str = "tent") -> int:
    """Add a rollout whose first wave is held, with rigs of its own, and return its number."""
    rigs = {f"{group or 'any'}-{kind}-{number}": kind for number in range(count)}
    for rig in rigs:
        page.add_rig(rig, group, kind)
    with Session(open_database(page.settings.database)) as session, session.begin():
        return add_held_rollout(session, time.time(), rigs, group, unsure=[kind]).number


def change(page: FleetPageOfTest, table: type[Any], key: object, **values: object) -> None:
    with Session(open_database(page.settings.database)) as session, session.begin():
        row = session.get_one(table, key)
        for name, value in values.items():
            setattr(row, name, value)


def rollouts(client: Client) -> list[dict[str, Any]]:
    found = client.get("/api/rollouts")
    assert found.ok, found.text
    return list(found.json()["rollouts"])


def error(found: Response) -> tuple[int, str]:
    return found.status_code, found.json()["error"]


def test_a_rollout_is_shown_with_its_waves_and_the_rigs_that_complain(page: FleetPageOfTest) -> None:
    number = begin(page, "north", 4)
    change(page, RolloutRig, (number, "north-tent-1"), state="refused", why="golden vector 3 is off")
    change(page, RolloutRig, (number, "north-tent-2"), offline_utc=time.time() - 3600.0)
    change(page, RolloutRig, (number, "north-tent-3"), offline_utc=time.time() - 60.0)  # no sign yet
    (found,) = rollouts(page.client("Ann", "north", Role.VIEW))
    assert {key: found[key] for key in ("number", "version", "group", "state", "role", "ended_utc")} == {
        "number": number,
        "version": "2.0",
        "group": "north",
        "state": "running",
        "role": "view",
        "ended_utc": None,
    }
    assert found["safe_from"] == pytest.approx(60.0)  # three waves, an error of 5 %
    (wave,) = found["waves"]
    assert (wave["wave"], wave["state"], wave["why"]) == (1, "held", "not shown to be within 10%: tent")
    assert (wave["rigs"], wave["kinds"]) == ({"active": 3, "refused": 1}, {"tent": UNSURE})
    assert [(row["rig"], row["state"], row["why"]) for row in found["complaints"]] == [
        ("north-tent-1", "refused", "refused: golden vector 3 is off"),
        ("north-tent-2", "active", "offline"),
    ]
    # Once it has ended nobody waits for a rig any more; what one has said stays.
    change(page, BundleRollout, number, state="done", ended_utc=time.time())
    (found,) = rollouts(page.client("Ann", "north", Role.VIEW))
    assert [row["rig"] for row in found["complaints"]] == ["north-tent-1"]


def test_an_order_that_is_not_obeyed_for_long_is_a_complaint(page: FleetPageOfTest) -> None:
    number, now = begin(page), time.time()
    change(page, RolloutRig, (number, "any-tent-0"), state="ordered", since_utc=now - 4000.0)
    change(page, RolloutRig, (number, "any-tent-1"), state="ordered", since_utc=now - 60.0)
    (row,) = rollouts(page.client("Ann"))[0]["complaints"]
    assert (row["rig"], row["why"]) == ("any-tent-0", "has not obeyed within 60 min")


def test_many_complaints_and_many_rollouts_are_cut_and_counted(page: FleetPageOfTest) -> None:
    number = begin(page, "", COMPLAINTS_MAX + 3)
    for each in range(COMPLAINTS_MAX + 3):
        change(page, RolloutRig, (number, f"any-tent-{each}"), state="refused", why="x" * 3000)
    chief = page.client("Chief")
    (found,) = rollouts(chief)
    assert (len(found["complaints"]), found["complaints_left_off"]) == (COMPLAINTS_MAX, 3)
    assert all(len(row["why"]) <= 200 for row in found["complaints"])
    with Session(open_database(page.settings.database)) as session, session.begin():
        for _ in range(SHOWN_MAX + 1):
            add_held_rollout(session, time.time(), {}).state = "stopped"
    answer = chief.get("/api/rollouts").json()
    assert (len(answer["rollouts"]), answer["left_off"]) == (SHOWN_MAX, 2)
    assert answer["rollouts"][0]["number"] == number + SHOWN_MAX + 1  # the newest first


def test_a_rollout_is_seen_by_those_with_a_role_where_it_is(page: FleetPageOfTest) -> None:
    north, south, whole = begin(page, "north"), begin(page, "south"), begin(page)
    ann, chief = page.client("Ann", "north", Role.ADMIN), page.client("Chief", role=Role.VIEW)
    assert [row["number"] for row in rollouts(ann)] == [north]
    assert [row["number"] for row in rollouts(chief)] == [whole, south, north]
    assert ann.get("/api/rigs").json()["held"] == ann.get("/api/alarms").json()["held"] == [north]
    assert chief.get("/api/rigs").json()["held"] == [north, south, whole]
    change(page, BundleRollout, whole, state="stopped")
    change(page, RolloutWave, (south, 1), state="judging")
    assert chief.get("/api/rigs").json()["held"] == [north]
    assert page.client().get("/api/rollouts").status_code == 401


@pytest.mark.parametrize("what", ["go-on", "stop"])
def test_only_an_admin_of_its_group_decides(page: FleetPageOfTest, what: str) -> None:
    north, south, whole = begin(page, "north"), begin(page, "south"), begin(page)
    ben = page.client("Ben", "north", Role.OPERATE)
    page.people.add("Ben", "south", Role.ADMIN, None)
    below = (403, "this needs the role admin, yours is operate")
    assert error(ben.post(f"/api/rollouts/{north}/{what}")) == below
    for hidden in (whole, 99, 10**30):
        assert error(ben.post(f"/api/rollouts/{hidden}/{what}")) == (404, NONE_HERE)
    assert error(page.client("Cleo").post(f"/api/rollouts/99/{what}")) == (404, NONE_HERE)
    assert error(page.client("Dan", role=Role.OPERATE).post(f"/api/rollouts/{whole}/{what}")) == below
    assert page.client().post(f"/api/rollouts/{south}/{what}").status_code == 401
    states = [(row["state"], row["waves"][0]["state"]) for row in rollouts(page.client("Chief"))]
    assert states == [("running", "held")] * 3
    assert ben.post(f"/api/rollouts/{south}/{what}").ok


def test_the_person_and_their_reason_stand_in_the_record(page: FleetPageOfTest) -> None:
    ann = page.client("Ann", "north", Role.ADMIN)
    first = begin(page, "north")
    for bad in ({"why": ""}, {"why": "x" * 201}, {"why": 7}):
        assert error(ann.post(f"/api/rollouts/{first}/go-on", bad)) == (
            400,
            "why: a text of 1 to 200 characters is needed",
        )
    assert ann.post(f"/api/rollouts/{first}/go-on", {"why": f"the tents\x1b[2J are {EVIL}"}).ok
    wave = rollouts(ann)[0]["waves"][0]
    assert (wave["state"], wave["why"]) == (
        "passed",
        f"Ann let it go on: the tents [2J are {EVIL}; not shown to be within 10%: tent",
    )
    assert ann.post(f"/api/rollouts/{first}/stop").ok
    found = rollouts(ann)[0]
    assert (found["state"], found["why"], found["waves"][0]["rigs"]) == (
        "stopped",
        "Ann stopped it",
        {"rolling back": 2},
    )


def test_who_comes_second_is_told_what_has_happened(page: FleetPageOfTest) -> None:
    ann, ben = page.client("Ann"), page.client("Ben")
    number = begin(page)
    assert ann.post(f"/api/rollouts/{number}/go-on").ok
    passed = f"rollout {number}: wave 1 is passed: only one that is held can go on"
    assert error(ben.post(f"/api/rollouts/{number}/go-on")) == (400, passed)
    change(page, BundleRollout, number, state="done")
    for what in ("go-on", "stop"):
        assert error(ben.post(f"/api/rollouts/{number}/{what}")) == (400, f"rollout {number} is done already")


def test_of_many_who_decide_at_once_one_alone_does(page: FleetPageOfTest) -> None:
    clients = [page.client(f"P{number}") for number in range(6)]
    number = begin(page)
    with ThreadPoolExecutor(len(clients)) as pool:
        found = pool.map(lambda own: own.post(f"/api/rollouts/{number}/go-on").status_code, clients)
    assert sorted(found) == [200] + [400] * 5
    why = rollouts(clients[0])[0]["waves"][0]["why"]
    assert why.count("let it go on") == 1


def test_each_kind_has_its_own_figures(page: FleetPageOfTest) -> None:
    for name, kind in (("a", "tent"), ("b", "case")):
        page.add_rig(name, kind=kind)
    with Session(open_database(page.settings.database)) as session, session.begin():
        add_held_rollout(session, time.time(), {"a": "tent", "b": "case"}, unsure=["case"])
    (found,) = rollouts(page.client("Ann"))
    assert found["waves"][0]["kinds"] == {"case": UNSURE, "tent": SAFE}
