"""Headless Chromium by the WebDriver protocol: opens a page of a Home Assistant and takes its picture."""

import base64
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, Self

import requests

from bench.support.broker import wait_for
from edge.board.virtual_rig import die_with_parent, end_process

# As root Chromium needs --no-sandbox; the others keep it from calling its maker.
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)
# A Home Assistant page is shadow trees within shadow trees, which no selector enters.
COUNT = """
const count = (node, name) => {
  let found = node.localName === name ? 1 : 0;
  for (const child of [...(node.shadowRoot?.children ?? []), ...node.children]) found += count(child, name);
  return found;
};
"""


class HeadlessChromium:
    """`with HeadlessChromium(folder) as browser:`; needs Debian's chromium and chromium-driver."""

    def __init__(self, folder: Path) -> None:
        self._log, self._profile = folder / "chromedriver.log", folder / "chromium"
        self._process: subprocess.Popen[bytes] | None = None
        self._url = ""

    def __enter__(self) -> Self:
        with self._log.open("wb") as out:
            # Port 0: the driver takes a free one, and says which.
            self._process = subprocess.Popen(
                ["chromedriver", "--port=0"], stdout=out, stderr=out, preexec_fn=die_with_parent
            )
        try:
            wait_for(self._port, f"chromedriver, see {self._log}")
            options = {"args": [*OPTIONS, f"--user-data-dir={self._profile}"]}
            asked = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
            self._url = f"http://127.0.0.1:{self._port()}/session"
            self._url += f"/{self._post('', asked)['sessionId']}"
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process is not None
        if self._url.count("/") > 3:
            requests.delete(self._url, timeout=30.0)
        end_process(self._process, patience_s=10.0)

    def log_in(self, url: str, token: str) -> None:
        """Give Home Assistant's page a token, where it looks for one."""
        tokens = {
            "access_token": token,
            "token_type": "Bearer",
            "expires_in": 86400,
            "hassUrl": url,
            "clientId": f"{url}/",
            "expires": 9e15,
            "refresh_token": "",
        }
        self._post("/url", {"url": f"{url}/manifest.json"})  # of the same origin
        self.run(f"localStorage.setItem('hassTokens', {json.dumps(json.dumps(tokens))})")
        self.run("localStorage.setItem('dockedSidebar', JSON.stringify('always_hidden'))")

    def keep_port(self, url: str) -> None:
        """Confirm the port, which newer versions ask for in a dialog; an older one refuses the command."""
        self.open(url, 1000, 1000)
        home = "document.querySelector('home-assistant')"
        wait_for(lambda: self.run(f"return {home}?.hass?.connected === true"), "the page", 60.0)
        self.run(f"return {home}.hass.callWS({{type: 'http/config/promote'}}).then(() => 1, () => 0)")

    def open(self, url: str, width: int, height: int) -> None:
        """Open a page in a window of this size [CSS pixels]."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._post("/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": size})
        self._post("/url", {"url": url})

    def count(self, element: str) -> int:
        """Return how many elements of this name the page has, in shadow trees too."""
        return int(self.run(f"{COUNT} return count(document, {json.dumps(element)})"))

    def run(self, script: str) -> Any:
        """Run JavaScript in the page and return its value."""
        return self._post("/execute/sync", {"script": script, "args": []})

    def picture(self, path: Path) -> None:
        """Save what the window shows as PNG."""
        answer = requests.get(f"{self._url}/screenshot", timeout=30.0).json()
        path.write_bytes(base64.b64decode(answer["value"]))

    def _port(self) -> int:
        found = re.search(r"started successfully on port (\d+)", self._log.read_text(errors="replace"))
        return int(found[1]) if found else 0

    def _post(self, path: str, body: Any) -> Any:
        answer = requests.post(f"{self._url}{path}", json=body, timeout=60.0).json()["value"]
        assert not (isinstance(answer, dict) and "error" in answer), answer
        return answer


def missing() -> list[str]:
    """Return the Debian packages that are still to be installed."""
    return [name for name, program in PROGRAMS.items() if shutil.which(program) is None]


PROGRAMS = {"chromium": "chromium", "chromium-driver": "chromedriver"}
