"""The database of a fleet: opened twice, refused where it is another's."""

from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.orm import Session

from edge.core.errors import DataError
from fleet.database.base import open_database
from fleet.database.rigs import FleetRig
from fleet.settings import DatabaseSettings


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
