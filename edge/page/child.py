"""The page of a demo: a process of its own that ends with the demo, and the link to open it."""

import importlib.util
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from edge.config.settings import PageSettings, Settings
from edge.core.processes import die_with_parent, end_process
from edge.page.access import DAY_S, Access, Role

HOST = "127.0.0.1"
PATIENCE_S = 5.0


@contextmanager
def page_of(settings: Settings, folder: Path, rig: str) -> Iterator[str]:
    """Serve the page of the rig whose files are in `folder`, to this machine alone.

    Yields its address with a link to enter by, or "" where the packages of the page are not installed
    """
    if not is_installed():
        yield ""
        return
    port, home = _free_port(), folder / "page"
    link = Access.of(home).make_link(Role.ADMIN, "you", DAY_S, uses=None)
    document = {
        "state_file": settings.state_file,
        "control_socket": {"path": settings.control_socket.path},
        "history": {"path": settings.history.path},
        "bundle": {"path": settings.bundle.path},
        "mqtt": {"rig": rig},
        "drift": {"reports": settings.drift.reports},
        "page": {"host": HOST, "port": port, "folder": str(home)},
    }
    file = folder / "page.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    command = [sys.executable, "-m", "edge.page", str(file)]
    with (folder / "page.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=die_with_parent)
    try:
        yield f"http://{HOST}:{port}/#link={link}"
    finally:
        end_process(process, PATIENCE_S)


def is_installed() -> bool:
    """Return whether the packages of the extra `page` are there."""
    return all(importlib.util.find_spec(name) is not None for name in ("starlette", "uvicorn"))


def _free_port() -> int:
    """Return the usual port, another one where a page has it already."""
    for port in (PageSettings().port, 0):
        try:
            with socket.create_server((HOST, port)) as listener:
                return int(listener.getsockname()[1])
        except OSError:
            continue
    raise OSError("no TCP port is free")
