"""A real Home Assistant of one version as a process, seen through its REST API alone."""

import base64
import hashlib
import hmac
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import requests
import yaml

from edge.core.processes import die_with_parent, end_process
from tests.support.broker import free_port, wait_for

START_S = 120.0  # a busy machine imports slowly
OWNER, TOKEN_ID, KEY = "0" * 32, "1" * 32, "2" * 128
# The mount ends with the process, in whose own space it is.
INSIDE = 'mount -t proc proc "$0/proc" && exec chroot "$0" "$@"'


class RealHomeAssistant:
    """`with RealHomeAssistant(tree, dashboard) as home:`; a fresh one at each entry, onboarding done.

    tree : as `install.sh` makes it; dashboard : YAML file of a Lovelace dashboard
    """

    def __init__(self, tree: Path, dashboard: Path) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.token = _token()
        self._tree, self._folder = tree, tree / "config"
        self._output = tree / "home-assistant.out"
        self._dashboard = dashboard
        self._process: subprocess.Popen[bytes] | None = None
        self._session = requests.Session()
        self._session.headers["Authorization"] = f"Bearer {self.token}"

    def __enter__(self) -> Self:
        shutil.rmtree(self._folder, ignore_errors=True)
        (self._folder / ".storage").mkdir(parents=True)
        for name, document in _stored().items():
            (self._folder / ".storage" / name).write_text(json.dumps(document))
        shutil.copy(self._dashboard, self._folder / "greenhouse.yaml")
        (self._folder / "configuration.yaml").write_text(yaml.safe_dump(_configuration(self.port)))
        self._output.unlink(missing_ok=True)
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start, and wait until it says that it runs."""
        program = ["/ha/bin/hass", "--skip-pip", "--config", "/config"]
        with self._output.open("ab") as out:
            self._process = subprocess.Popen(
                ["unshare", "--mount", "sh", "-c", INSIDE, str(self._tree), *program],
                stdout=out,
                stderr=out,
                preexec_fn=die_with_parent,
            )
        wait_for(self._runs, f"Home Assistant runs, see {self._output}", START_S)

    def stop(self) -> None:
        """End in good order."""
        if self._process is not None:
            end_process(self._process, patience_s=30.0)
            self._process = None

    def connect_to_broker(self, port: int) -> None:
        """Set the integration MQTT up, as its form in the settings does."""
        flow = self._post("config/config_entries/flow", handler="mqtt")
        form: dict[str, Any] = {"broker": "127.0.0.1", "port": port}
        if any(field["name"] == "other_settings" for field in flow["data_schema"]):  # of newer versions
            form["other_settings"] = {"set_client_cert": False, "set_ca_cert": "off"}
        done = self._post(f"config/config_entries/flow/{flow['flow_id']}", **form)
        assert done["type"] == "create_entry", done

    def states(self) -> dict[str, dict[str, Any]]:
        """Return every entity by its id."""
        return {entity["entity_id"]: entity for entity in self._get("states")}

    def entity(self, id: str) -> dict[str, Any]:
        """Return state and attributes of one entity."""
        return dict(self._get(f"states/{id}"))

    def call(self, service: str, entity: str, **values: Any) -> None:
        """Call a service, as a card does when it is touched. service : `climate.set_temperature`, say"""
        self._post(f"services/{service.replace('.', '/')}", entity_id=entity, **values)

    def complaints(self) -> list[str]:
        """Return warnings and errors of the log so far, each with its first line only."""
        text = self._output.read_text(errors="replace")
        return re.findall(r"^\S+ \S+ ((?:WARNING|ERROR|CRITICAL) .*)$", text, re.MULTILINE)

    def _runs(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, self._output.read_text(errors="replace")[-2000:]
        try:
            return bool(self._get("config")["state"] == "RUNNING")
        except requests.ConnectionError:
            return False

    def _get(self, path: str) -> Any:
        answer = self._session.get(f"{self.url}/api/{path}", timeout=10.0)
        answer.raise_for_status()
        return answer.json()

    def _post(self, path: str, **values: Any) -> Any:
        answer = self._session.post(f"{self.url}/api/{path}", json=values, timeout=10.0)
        assert answer.ok, f"{path}: {answer.status_code} {answer.text}"
        return answer.json()


def _configuration(port: int) -> dict[str, Any]:
    dashboard = {"mode": "yaml", "title": "Greenhouse", "filename": "greenhouse.yaml"}
    return {
        "homeassistant": {"name": "Test", "time_zone": "UTC", "unit_system": "metric"},
        "http": {"server_host": "127.0.0.1", "server_port": port},
        "frontend": {},
        "history": {},
        "logger": {"default": "warning"},
        "lovelace": {"dashboards": {"green-house": dashboard}},
    }


def _stored() -> dict[str, Any]:
    """Return files of `.storage`: an owner with a long-lived token, and an onboarding that is over."""
    owner = {"id": OWNER, "group_ids": ["system-admin"], "is_owner": True, "is_active": True, "name": "Owner"}
    token = {
        "id": TOKEN_ID,
        "user_id": OWNER,
        "client_id": None,
        "client_name": "test",
        "client_icon": None,
        "token_type": "long_lived_access_token",
        "created_at": "2025-01-01T00:00:00+00:00",
        "access_token_expiration": 3.2e8,
        "token": KEY,
        "jwt_key": KEY,
        "last_used_at": None,
        "last_used_ip": None,
        "expire_at": None,
        "credential_id": None,
        "version": None,
    }
    auth = {
        "users": [{**owner, "system_generated": False, "local_only": False}],
        "groups": [{"id": "system-admin", "name": "Administrators"}],
        "credentials": [],
        "refresh_tokens": [token],
    }
    steps = {"done": ["user", "core_config", "analytics", "integration"]}
    return {
        "auth": {"version": 1, "minor_version": 1, "key": "auth", "data": auth},
        "onboarding": {"version": 4, "minor_version": 1, "key": "onboarding", "data": steps},
    }


def _token() -> str:
    """Return the JSON web token that belongs to the stored one."""
    now = int(time.time())
    claims = {"iss": TOKEN_ID, "iat": now - 60, "exp": now + 86400}
    head = ".".join(_base64(json.dumps(part).encode()) for part in ({"alg": "HS256", "typ": "JWT"}, claims))
    return f"{head}.{_base64(hmac.new(KEY.encode(), head.encode(), hashlib.sha256).digest())}"


def _base64(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()
