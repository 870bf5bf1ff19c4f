"""The page behind caddy, by the certificate, the Caddyfile and the settings of the manual."""

import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path

import pytest
import requests
from requests.adapters import HTTPAdapter

from edge.commands.page import address
from edge.config.settings import PageSettings, Settings
from edge.core.processes import end_process
from edge.page.access import DAY_S, Role
from tests.support.broker import free_port, wait_for
from tests.support.daemon_process import ROOT
from tests.support.page_process import Client, PageProcess, cookie_of, listens, page_of

pytestmark = pytest.mark.slow
NAME = "greenhouse.example.org"
MANUAL = (ROOT / "docs" / "page.md").read_text(encoding="utf-8")


class ToCaddy(HTTPAdapter):
    """Connects to this machine under the name that the certificate is for."""

    def init_poolmanager(self, *words: object, **options: object) -> None:
        super().init_poolmanager(*words, server_hostname=NAME, assert_hostname=NAME, **options)


class NamedClient(Client):
    """A browser that knows the rig by its proxy's name."""

    def __init__(self, port: int, authority: Path) -> None:
        super().__init__(f"https://127.0.0.1:{port}", str(authority))
        self.session.mount("https://", ToCaddy())
        self.name = f"{NAME}:{port}"
        self.session.headers["host"] = self.name

    def post(self, path: str, values: object = None, **headers: str) -> requests.Response:
        return super().post(path, values, **{"origin": f"https://{self.name}", **headers})


def fence(title: str) -> str:
    """Code of the manual."""
    found = re.search(rf'^```\w+ title="{re.escape(title)}"\n(.*?)^```$', MANUAL, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


@contextmanager
def caddy_before(page_port: int, folder: Path) -> Iterator[tuple[int, Path]]:
    """Start caddy with the manual's own file and certificate; only places and ports are this machine's."""
    folder.mkdir()
    port, certificate = free_port(), folder / "greenhouse.crt"
    make = fence("a certificate").replace("/etc/caddy", str(folder)).replace("sudo ", "")
    subprocess.run(["sh", "-e", "-c", make], check=True, capture_output=True)
    text = fence("/etc/caddy/Caddyfile").replace("/etc/caddy", str(folder))
    text = text.replace(f"{NAME} {{", f"{NAME}:{port} {{").replace(":8420", f":{page_port}")
    # Not in the manual's: caddy's own administration and its redirection have fixed ports.
    head = "{\n admin off\n auto_https disable_redirects\n}\n"
    (folder / "Caddyfile").write_text(head + text)
    program = shutil.which("caddy")
    assert program is not None, "apt install caddy"
    places = {"HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    with (folder / "caddy.log").open("wb") as log:
        command = [program, "run", "--config", str(folder / "Caddyfile"), "--adapter", "caddyfile"]
        process = subprocess.Popen(command, stdout=log, stderr=log, env=places)
    try:
        wait_for(lambda: listens(port) or process.poll() is not None, f"caddy, see {folder}/caddy.log")
        assert process.poll() is None, (folder / "caddy.log").read_text()
        yield port, certificate
    finally:
        end_process(process, patience_s=15.0)


@pytest.fixture(scope="module")
def behind() -> Iterator[tuple[PageProcess, int, Path]]:
    """A page, and the port and certificate of the caddy before it."""
    with (
        tempfile.TemporaryDirectory(prefix="gh-") as name,
        page_of(Path(name), host="127.0.0.1", names=[NAME]) as page,
        caddy_before(page.port, Path(name) / "caddy") as (port, certificate),
    ):
        yield page, port, certificate


@pytest.fixture
def browser(behind) -> NamedClient:
    page, port, certificate = behind
    client = NamedClient(port, certificate)
    link = page.access.make_link(Role.OPERATE, "Ann", DAY_S)
    assert client.post("/api/session", {"link": link}).json()["ok"]
    return client


def test_behind_caddy_a_link_opens_the_page_and_orders_are_taken(browser: NamedClient) -> None:
    assert browser.get("/").ok
    assert cookie_of(browser).secure
    assert browser.get("/api/me").json()["name"] == "Ann"
    assert browser.post("/api/stop").json()["waits"]
    assert browser.post("/api/order", {"do": "set_mode", "mode": "off"}).status_code == 504  # no daemon
    for origin in ("https://evil.example", f"https://{NAME}", "null"):
        assert browser.post("/api/stop", origin=origin).status_code == 403


def test_behind_caddy_what_the_rig_does_arrives_at_once(browser: NamedClient) -> None:
    with closing(browser.session.get(f"{browser.base}/api/stream", stream=True, timeout=20)) as answer:
        lines = (line for line in answer.iter_lines(chunk_size=1) if line.startswith(b"data: "))
        views = (json.loads(line.removeprefix(b"data: ")) for line in lines)
        for _ in range(3):
            before = time.time()
            browser.post("/api/stop")
            # A proxy that collects parts of an answer would give nothing, and the reading would time out.
            known = (view["stop_waits"] or {"utc": 0.0} for view in islice(views, 4))
            assert any(stop["utc"] >= before - 0.01 for stop in known)  # it is rounded


def test_behind_caddy_another_name_is_refused_by_caddy_and_by_the_page(behind, browser: NamedClient) -> None:
    page, _, _ = behind
    nobody = Client(page.base)
    assert nobody.get("/", host=NAME).ok
    assert nobody.get("/", host="evil.example").status_code == 421
    assert b"Greenhouse" not in browser.get("/", host="evil.example").content


def test_without_page_names_nobody_comes_through_a_proxy() -> None:
    with (
        tempfile.TemporaryDirectory(prefix="gh-") as name,
        page_of(Path(name), host="127.0.0.1") as page,
        caddy_before(page.port, Path(name) / "caddy") as (port, certificate),
    ):
        refused = NamedClient(port, certificate).get("/")
        assert refused.status_code == 421
        assert "page.names" in refused.json()["error"]


@pytest.mark.parametrize(
    ("page", "expected"),
    [
        (PageSettings(host="127.0.0.1", names=(NAME,)), f"https://{NAME}/"),
        (PageSettings(host="::1", names=(NAME,)), f"https://{NAME}/"),
        (PageSettings(names=(NAME,)), f"http://{NAME}:8420/"),
        (PageSettings(names=(NAME,), certificate="c", key_file="k"), f"https://{NAME}:8420/"),
        (PageSettings(host="127.0.0.1"), "http://127.0.0.1:8420/"),
        (PageSettings(host="192.168.1.5"), "http://192.168.1.5:8420/"),
    ],
)
def test_a_link_leads_to_the_proxy_where_only_the_proxy_reaches_the_page(page, expected) -> None:
    assert address(Settings(page=page), opened=True) == expected
