"""The page as a process for tests, and a client that asks as a browser does."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import requests
import yaml

from bench.support.broker import free_port, wait_for
from bench.support.daemon_process import ROOT, configuration
from edge.board.virtual_rig import die_with_parent
from edge.page.access import DAY_S, Access, Role

END_S = 15.0


class Client:
    """One browser's session. Changes carry the headers that a browser sends from the page itself."""

    def __init__(self, base: str) -> None:
        self.base = base
        self.session = requests.Session()
        self.session.trust_env = False

    def get(self, path: str, **headers: str) -> requests.Response:
        return self.session.get(self.base + path, headers=headers, timeout=20)

    def send(self, method: str, path: str, values: Any = None, **headers: str) -> requests.Response:
        own = {"origin": self.base, "sec-fetch-site": "same-origin", "content-type": "application/json"}
        own |= {name.replace("_", "-"): value for name, value in headers.items()}
        return self.session.request(
            method, self.base + path, json={} if values is None else values, headers=own, timeout=20
        )

    def post(self, path: str, values: Any = None, **headers: str) -> requests.Response:
        return self.send("POST", path, values, **headers)

    def view(self) -> dict[str, Any]:
        return dict(self.get("/api/view").json())


class PageProcess:
    """A running page of the rig whose files are in `folder`."""

    def __init__(self, folder: Path, port: int) -> None:
        self.config, self._log = folder / "page.yaml", folder / "page.log"
        self.base = f"http://127.0.0.1:{port}"
        self.access = Access(folder / "page" / "page.db")
        settings = configuration(folder, None) | {"page": {"port": port, "folder": str(folder / "page")}}
        self.config.write_text(yaml.safe_dump(settings))
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "edge", "page", "--config", str(self.config)],
                stdout=log, stderr=log, cwd=ROOT, preexec_fn=die_with_parent,
            )  # fmt: skip
        wait_for(lambda: self._answers() or self.process.poll() is not None, "the page")
        assert self.process.poll() is None, self._log.read_text()

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait(END_S)

    def client(self, role: Role | None = Role.ADMIN, name: str = "Ann") -> Client:
        """Return a browser that has entered by a link, or one without a session."""
        client = Client(self.base)
        if role is not None:
            link = self.access.make_link(role, name, DAY_S)
            assert client.post("/api/session", {"link": link}).ok
        return client

    def _answers(self) -> bool:
        try:
            return requests.get(self.base, timeout=2).ok
        except requests.RequestException:
            return False


@contextmanager
def page_of(folder: Path) -> Iterator[PageProcess]:
    page = PageProcess(folder, free_port())
    try:
        page.start()
        yield page
    finally:
        page.kill()
