"""A lease, on both databases: one holder at a time, and the next when it ends, dies or falls silent."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine, text, update
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from edge.core.processes import die_with_parent
from fleet.database.base import open_database
from fleet.database.lease import FleetLease, LeaseLost, WorkLease
from fleet.database.tables import FleetRig
from fleet.settings import DatabaseSettings
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT
from tests.support.postgres import needs_postgres

HOLDER = """
import sys, threading
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.settings import DatabaseSettings
lease = FleetLease(open_database(DatabaseSettings(url=sys.argv[1])), "rollouts")
assert lease.take() == ""
with lease.keep():
    print("taken", flush=True)
    threading.Event().wait()
"""


def test_what_was_written_is_there_after_the_next_opening(tmp_path: Path) -> None:
    settings = DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")
    with Session(open_database(settings)) as session, session.begin():
        session.add(FleetRig(name="rig-1", first_utc=1.0, last_utc=2.0))
    with Session(open_database(settings)) as session:
        rig = session.get(FleetRig, "rig-1")
        assert rig is not None
        assert (rig.kind, rig.state, rig.is_online) == ("", {}, False)


def test_tables_of_earlier_software_go_as_their_rows_would_keep_a_rig(tmp_path: Path) -> None:
    settings = DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")
    with open_database(settings).begin() as connection:
        connection.execute(text("INSERT INTO rigs VALUES ('rig-1', '', '', 1.0, 2.0, 0, '{}')"))
        connection.execute(text("CREATE TABLE departures (rig TEXT PRIMARY KEY REFERENCES rigs (name))"))
        connection.execute(text("INSERT INTO departures VALUES ('rig-1')"))
    with open_database(settings).begin() as connection:
        connection.execute(text("DELETE FROM rigs"))


def test_tables_of_another_version_are_refused(tmp_path: Path) -> None:
    settings = DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")
    with open_database(settings).begin() as connection:
        connection.execute(text("UPDATE table_version SET version = 7"))
    with pytest.raises(DataError, match="version 7"):
        open_database(settings)


@pytest.mark.parametrize("url", ["sqlite:////nowhere/at/all.db", "postgresql+psycopg://u@127.0.0.1:9/none"])
def test_a_database_that_cannot_be_reached_is_named(url: str) -> None:
    with pytest.raises(DataError, match=r"database\.url"):
        open_database(DatabaseSettings(url=url))


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=needs_postgres)])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/fleet.db"
    return str(request.getfixturevalue("postgres").url)


@pytest.fixture
def engine(url: str) -> Iterator[Engine]:
    own = open_database(DatabaseSettings(url=url))
    yield own
    with Session(own) as session, session.begin():
        session.query(WorkLease).delete()
    own.dispose()


def on_another_machine(engine: Engine) -> None:
    """Let the holder be of a machine whose processes are not known here."""
    with Session(engine) as session, session.begin():
        session.execute(update(WorkLease).values(machine="elsewhere", host="elsewhere"))


def test_one_of_many_that_come_at_once_takes_it(engine: Engine) -> None:
    leases, found = [FleetLease(engine, "rollouts") for _ in range(8)], list[str]()
    start = threading.Barrier(len(leases))

    def take(lease: FleetLease) -> None:
        start.wait()
        found.append(lease.take())

    threads = [threading.Thread(target=take, args=(lease,)) for lease in leases]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == len(leases) and found.count("") == 1
    assert FleetLease(engine, "another work").take() == ""


def test_it_is_free_at_once_when_it_is_given_back(engine: Engine) -> None:
    first, second = FleetLease(engine, "rollouts"), FleetLease(engine, "rollouts")
    with Session(engine) as session, session.begin():
        assert first.take() == ""
        assert second.take().startswith("process ")
    first.give_back()
    assert second.take() == ""
    first.give_back()  # no more its own
    assert first.take() != ""


def test_it_is_free_at_once_when_its_process_was_killed(engine: Engine, url: str) -> None:
    words = [sys.executable, "-c", HOLDER, url]
    with subprocess.Popen(words, stdout=subprocess.PIPE, cwd=ROOT, preexec_fn=die_with_parent) as process:
        assert process.stdout is not None and process.stdout.readline() == b"taken\n"
        lease = FleetLease(engine, "rollouts")
        assert lease.take().startswith(f"process {process.pid} of ")
        process.kill()
    assert lease.take() == ""


def test_a_holder_elsewhere_keeps_it_while_it_beats_and_loses_it_in_silence(engine: Engine) -> None:
    first, second = FleetLease(engine, "rollouts", lease_s=1.0), FleetLease(engine, "rollouts", lease_s=5.0)
    assert first.take() == ""
    ended = threading.Event()
    taken: list[bool] = []
    with first.keep():
        on_another_machine(engine)
        thread = threading.Thread(target=lambda: taken.append(second.wait(ended, lambda text: None)))
        thread.start()
        assert not ended.wait(6.0) and not taken  # longer than its lease, and it beats
    wait_for(lambda: taken == [True], "the work is free after the end", 30.0)
    thread.join()
    with Session(engine) as session, pytest.raises(LeaseLost):
        first.check(session)
    third = FleetLease(engine, "rollouts", lease_s=0.5)
    on_another_machine(engine)  # nobody beats from here on
    assert third.take() == f"process {os.getpid()} of elsewhere"
    assert third.wait(threading.Event(), lambda text: None)
