"""The database: opened, its tables made, its version held."""

from typing import Any

from sqlalchemy import Engine, create_engine, event, make_url, select, text
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from edge.config.secrets import read_secret
from edge.core.errors import DataError
from fleet.database.tables import FleetTable, TableVersion
from fleet.settings import DatabaseSettings

VERSION = 1  # of the tables
# Of earlier software: their rows would keep a rig from being erased.
GONE = ("rehearsals", "box_rehearsals", "hour_rehearsals", "structure_fits", "departures", "priors")
BUSY_S = 30.0  # SQLite: another process holds the lock for milliseconds
POSTGRES = {  # libpq: a server whose machine is gone is noticed after half a minute
    "connect_timeout": 10,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 4,
    "tcp_user_timeout": 30_000,
}


def open_database(settings: DatabaseSettings) -> Engine:
    """Open it; tables that are missing are made.

    Errors : DataError for a database that cannot be reached or whose tables are of another version
    """
    url = make_url(settings.url)
    if settings.password_file:
        url = url.set(password=read_secret(settings.password_file, "database.password_file").value)
    is_sqlite = url.get_backend_name() == "sqlite"
    options: dict[str, Any] = {"timeout": BUSY_S} if is_sqlite else POSTGRES
    engine = create_engine(url, connect_args=options, pool_pre_ping=True)
    if is_sqlite:
        event.listen(engine, "connect", _set_pragmas)
    try:
        with Session(engine) as session, session.begin():
            for name in GONE:
                session.execute(text(f"DROP TABLE IF EXISTS {name}"))
            FleetTable.metadata.create_all(session.connection())
            found = session.scalars(select(TableVersion.version)).all()
            if not found:
                session.add(TableVersion(version=VERSION))
    except SQLAlchemyError as error:
        raise DataError(f"database.url: {url.render_as_string()}: {error.__cause__ or error}") from None
    if found and list(found) != [VERSION]:
        raise DataError(f"database.url: its tables are of version {found[0]}, this software knows {VERSION}")
    return engine


def _set_pragmas(connection: Any, record: object) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
