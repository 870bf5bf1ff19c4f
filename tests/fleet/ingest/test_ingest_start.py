"""Starts of ingest that cannot succeed: it ends and says which setting is wrong."""

from pathlib import Path

from tests.support.broker import PATIENCE_S, free_port
from tests.support.ingest_process import IngestProcess
from tests.support.postgres import Postgres, needs_postgres


def ends_with(folder: Path, url: str) -> str:
    with IngestProcess(folder, {"port": free_port()}, f"http://127.0.0.1:{free_port()}", url) as ingest:
        assert ingest.process is not None
        assert ingest.process.wait(PATIENCE_S) == 2
        return ingest.log


def test_a_database_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    url = "sqlite:////nowhere/at/all.db"
    assert f"database.url: {url}: " in ends_with(tmp_path, url)


@needs_postgres
def test_a_user_whom_the_database_refuses_is_named(tmp_path: Path, postgres: Postgres) -> None:
    said = ends_with(tmp_path, postgres.url.replace("postgres@", "stranger@"))
    assert "database.url: postgresql+psycopg://stranger@" in said
    assert "stranger" in said.partition("/postgres: ")[2]
