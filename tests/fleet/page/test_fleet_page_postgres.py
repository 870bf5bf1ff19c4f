"""The fleet's page over PostgreSQL: people, rigs, orders, alarms, and a database that is away for a while."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fleet_pages import TOKEN, FleetPageOfTest, fleet_page
from sqlalchemy.orm import Session

from edge.page.access import Role
from fleet.database.base import open_database
from fleet.settings import DatabaseSettings
from tests.support.broker import wait_for
from tests.support.held_rollout import add_held_rollout
from tests.support.postgres import Postgres, needs_postgres

pytestmark = needs_postgres


@pytest.fixture
def page(tmp_path: Path, postgres: Postgres) -> Iterator[FleetPageOfTest]:
    with fleet_page(tmp_path, database=DatabaseSettings(url=postgres.new_database())) as running:
        yield running


def test_people_rigs_and_alarms_are_as_over_sqlite(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north", "tent")
    page.add_rig("b-1", "south", "tent", last_utc=time.time() - 900.0)
    ann = page.client("Ann", "north", Role.OPERATE)
    assert [rig["name"] for rig in ann.get("/api/rigs").json()["rigs"]] == ["a-1"]
    assert ann.get("/api/rigs/b-1").status_code == 404
    labels = {"alertname": "rig_silent", "rig": "a-1", "severity": "alarm"}
    alert = {"labels": labels, "annotations": {"text": "silent"}, "endsAt": "2100-01-01T00:00:00Z"}
    word = {"authorization": f"Bearer {TOKEN}"}
    for _ in range(2):
        assert page.client().post("/api/v2/alerts", [alert], **word).ok
    (alarm,) = ann.get("/api/alarms?lasting=1").json()["alarms"]
    assert ann.post(f"/api/alarms/{alarm['id']}/acknowledge").ok
    assert ann.get("/api/alarms").json()["alarms"][0]["seen_by"] == "Ann"
    page.people.remove("Ann")
    assert ann.get("/api/me").status_code == 401


def test_of_many_who_decide_about_a_rollout_at_once_one_alone_does(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north", "tent")
    with Session(open_database(page.settings.database)) as session, session.begin():
        number = add_held_rollout(session, time.time(), {"a-1": "tent"}, "north", unsure=["tent"]).number
    clients = [page.client(f"P{each}", "north", Role.ADMIN) for each in range(4)]
    with ThreadPoolExecutor(len(clients)) as pool:
        found = pool.map(lambda own: own.post(f"/api/rollouts/{number}/go-on").status_code, clients)
    assert sorted(found) == [200, 400, 400, 400]
    (rollout,) = clients[0].get("/api/rollouts").json()["rollouts"]
    (wave,) = rollout["waves"]
    assert (wave["state"], wave["rigs"], wave["why"].count("let it go on")) == ("passed", {"active": 1}, 1)
    assert clients[0].post(f"/api/rollouts/{10**30}/stop").status_code == 404


def test_a_database_that_was_away_is_an_error_with_a_reason_and_then_forgotten(
    page: FleetPageOfTest, postgres: Postgres
) -> None:
    ann = page.client("Ann")
    postgres.kill()
    away = ann.get("/api/rigs")
    assert away.status_code == 503
    assert away.json()["error"].startswith("the database does not answer")
    postgres.start()
    wait_for(lambda: ann.get("/api/rigs").ok, "the page's answer after the database's", 60.0)
