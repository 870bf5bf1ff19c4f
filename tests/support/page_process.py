"""The page as a process for tests, and a client that asks as a browser does."""

import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.cookiejar import Cookie
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import requests
import yaml
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver

from edge.page.access import DAY_S, Access, Role
from edge.page.cookie import COOKIE
from tests.support.broker import free_port, wait_for
from tests.support.daemon_process import ChildProcess, DaemonProcess, configuration
from tests.support.virtual_board import VirtualBoard, virtual_board


class Client:
    """One browser's session. Changes carry the headers that a browser sends from the page itself.

    authority : file of the certificate to trust, "" for the usual ones
    """

    def __init__(self, base: str, authority: str = "") -> None:
        self.base = base
        self.session = requests.Session()
        self.session.trust_env = False
        self.session.verify = authority or True

    def get(self, path: str, **headers: str) -> requests.Response:
        """Ask for a page or a value."""
        return self.session.get(self.base + path, headers=headers, timeout=20)

    def send(self, method: str, path: str, values: Any = None, **headers: str) -> requests.Response:
        """Send JSON; `_` in the name of a header stands for `-`."""
        own = {"origin": self.base, "sec-fetch-site": "same-origin", "content-type": "application/json"}
        own |= {name.replace("_", "-"): value for name, value in headers.items()}
        return self.session.request(
            method, self.base + path, json={} if values is None else values, headers=own, timeout=20
        )

    def post(self, path: str, values: Any = None, **headers: str) -> requests.Response:
        """Send a change."""
        return self.send("POST", path, values, **headers)

    def view(self) -> dict[str, Any]:
        """Return what the page knows now."""
        return dict(self.get("/api/view").json())


class PageProcess(ChildProcess):
    """A running page of the rig whose files are in `folder`.

    sections : further sections of its configuration; page : settings of its own one
    """

    def __init__(
        self, folder: Path, port: int, sections: Mapping[str, Any] | None = None, **page: Any
    ) -> None:
        self.config, self.log_file = folder / "page.yaml", folder / "page.log"
        self._authority = str(page.get("certificate", ""))
        self.port = port
        self.base = f"{'https' if self._authority else 'http'}://127.0.0.1:{port}"
        self.access = Access(folder / "page" / "page.db")
        own = {"port": port, "folder": str(folder / "page"), **page}
        settings = configuration(folder, None) | {"page": own} | dict(sections or {})
        self.config.write_text(yaml.safe_dump(settings))

    @property
    def command(self) -> list[str]:
        """Return its command line."""
        return [sys.executable, "-m", "edge", "page", "--config", str(self.config)]

    def start(self) -> None:
        """Start, and wait until it answers."""
        self.launch()
        wait_for(lambda: self.answers() or self.has_ended(), "the page")
        assert not self.has_ended(), self.log

    def client(self, role: Role | None = Role.ADMIN, name: str = "Ann") -> Client:
        """Return a browser that has entered by a link, or one without a session."""
        client = Client(self.base, self._authority)
        if role is not None:
            link = self.access.make_link(role, name, DAY_S)
            assert client.post("/api/session", {"link": link}).ok
        return client

    def answers(self) -> bool:
        """Return whether it serves the page."""
        try:
            return requests.get(self.base, timeout=2, verify=self._authority or True).ok
        except requests.RequestException:
            return False


@contextmanager
def page_of(folder: Path, sections: Mapping[str, Any] | None = None, **page: Any) -> Iterator[PageProcess]:
    """Start a page, with `sections` as in PageProcess; kill it at the end."""
    running = PageProcess(folder, free_port(), sections, **page)
    try:
        running.start()
        yield running
    finally:
        running.kill()


@contextmanager
def rig_with_page(
    kind: type[DaemonProcess] = DaemonProcess, **sections: Mapping[str, Any]
) -> Iterator[tuple[DaemonProcess, PageProcess, VirtualBoard]]:
    """Start a board in real time, its daemon and its page, for the tests of a file.

    kind, sections : of the daemon, and of its configuration
    """
    with (
        TemporaryDirectory(prefix="gh-") as name,  # short, for the names of sockets
        virtual_board(Path(name), "--real-time") as board,
        kind(Path(name), None, **sections) as daemon,
        page_of(Path(name)) as page,
    ):
        yield daemon, page, board


def as_at_first(daemon: DaemonProcess) -> None:
    """Take back what the test before has ordered, and wait until the page has seen it."""
    for do, values in (
        ("release_emergency_stop", {}),
        ("set_mode", {"mode": "auto"}),
        ("set_reference", {"reference_c": None}),
        ("set_controller", {"name": None}),
    ):
        assert daemon.ask(do, **values)["ok"]
    daemon.wait_ticks(3)  # a page looks every second


def open_page(
    driver: WebDriver, page: PageProcess, role: Role = Role.ADMIN, name: str = "Ann", group: str = "control"
) -> None:
    """Enter by a link and open a group of cards: control, twin or rig."""
    driver.get(f"{page.base}/#link={page.access.make_link(role, name, DAY_S)}")
    wait_for(lambda: driver.find_elements(By.TAG_NAME, "nav"), "the page")
    assert "link=" not in driver.current_url
    driver.execute_script(f"document.querySelector('nav a[href=\\'#{group}\\']').click()")


def cookie_of(client: Client) -> Cookie:
    """Return the cookie of a client's session."""
    return next(cookie for cookie in client.session.cookies if cookie.name == COOKIE)


def listens(port: int) -> bool:
    """Return whether somebody listens at a port of the loopback."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def view(
    reached: bool = True, silent_s: float | None = 0.0, waits: Any = None, **status: Any
) -> dict[str, Any]:
    tick = {"seq": 5, "step_s": 60.0, "readings": {"temp_air_c": {"value": 24.0, "quality": "good"}}}
    known = {
        "operation": {"emergency_stop": False},
        "since_start_s": 1e5,
        "trips": [],
        "tick": tick,
        "echo": {"tripped": 0, "trip_cause": ""},
        "link_up": 1,
        "conditions": {},
    } | status
    return {
        "reached": reached,
        "error": "" if reached else "no daemon listens at /run/x",
        "silent_s": silent_s,
        "lease_s": 10.0,
        "stop_waits": waits,
        "status": known if reached or silent_s is not None else None,
    }
