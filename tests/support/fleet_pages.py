"""The fleet's page in a thread, over a SQLite file, for tests."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import uvicorn
from sqlalchemy.orm import Session

from edge.config.settings import PageSettings
from edge.page.access import Role
from edge.page.server import config_of, listen
from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.page.app import make_fleet_app
from fleet.page.people import EVERY, People
from fleet.settings import DatabaseSettings, FleetPageSettings, FleetSettings
from tests.support.broker import free_port, wait_for
from tests.support.page_process import Client, listens

PASSWORD = "a good long one"
TOKEN = "only vmalert knows this"
STATE = {"temp_air_c": 24.0, "reference_c": 24.1, "heater_duty": 0.35, "mode": "auto", "link_up": 1}


class QuietServer(uvicorn.Server):
    """A server that leaves the signals of the test's process alone."""

    def install_signal_handlers(self) -> None:
        """Install none."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


@dataclass(frozen=True)
class FleetPageOfTest:
    """A page that runs. port : where it listens"""

    port: int
    settings: FleetSettings

    @property
    def base(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def people(self) -> People:
        return People(open_database(self.settings.database))

    def client(self, name: str = "", group: str = EVERY, role: Role = Role.ADMIN) -> Client:
        """Return a browser of somebody with this role, of nobody without a name."""
        client = Client(self.base)
        if name:
            self.people.add(name, group, role, PASSWORD)
            found = client.post("/api/session", {"name": name, "password": PASSWORD})
            assert found.ok, found.text
        return client

    def add_rig(self, name: str, group: str = "", kind: str = "", **values: Any) -> None:
        now = time.time()
        known = {"first_utc": now, "last_utc": now, "is_online": True, "state": STATE} | values
        with Session(open_database(self.settings.database)) as session, session.begin():
            session.merge(FleetRig(name=name, group=group, kind=kind, **known))


@contextmanager
def fleet_page(folder: Path, **sections: Any) -> Iterator[FleetPageOfTest]:
    """Serve a fleet's page until the end. sections : of its settings, in place of the usual ones"""
    token = folder / "alerts.token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    port = free_port()
    settings = FleetSettings(
        database=DatabaseSettings(url=f"sqlite:///{folder}/fleet.db"),
        page=FleetPageSettings(port=port, alert_token_file=str(token)),
    )
    settings = replace(settings, **sections)
    place = PageSettings(host="127.0.0.1", port=port)
    server = QuietServer(config_of(make_fleet_app(settings), place))
    sockets = list(listen(place, opened=False))
    thread = threading.Thread(target=server.run, args=(sockets,))
    thread.start()
    try:
        wait_for(lambda: server.started or not thread.is_alive(), "the fleet's page")
        assert listens(port)
        yield FleetPageOfTest(port, settings)
    finally:
        server.should_exit = True
        thread.join(30.0)
        assert not thread.is_alive()
        for each in sockets:
            each.close()
