"""A Debian machine in a container under systemd-nspawn: its own systemd, this machine's kernel and network.

It is quick where a machine of its own is slow. A cut of its power ends every process at once; no disk loses
its cache, which only `boot_machine` shows.
"""

import os
import signal
import subprocess
import time
from pathlib import Path

from boot_machine import BOOT_MAX_S, ShellError
from boot_report import wait_for

from edge.core.processes import die_with_parent

NSPAWN = ("systemd-nspawn", "-q", "--boot", "--register=no", "--keep-unit", "--resolv-conf=replace-host")
PATH = "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class Container:
    """The container of a tree, not started yet; to be used as a Machine is."""

    CUT = "every process is killed at once"

    def __init__(self, root: Path, name: str) -> None:
        self._root, self._name = root, name
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Boot it. Returns : the time that it took [s]"""
        began = time.monotonic()
        words = [*NSPAWN, "-D", str(self._root), f"--machine={self._name}"]
        with self._root.with_name("container.log").open("ab") as log:
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, preexec_fn=die_with_parent
            )
        wait_for(self._is_up, BOOT_MAX_S, "the container is up")
        return time.monotonic() - began

    def sh(self, command: str, patience_s: float = 300.0) -> str:
        """Run a shell command in it and return its output. Errors: ShellError; TimeoutExpired"""
        words = ["nsenter", "-t", str(self._first()), "-a", "env", "-i", PATH, "sh", "-c", command]
        done = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=patience_s,
        )
        said = done.stdout.decode(errors="replace").strip()
        if done.returncode:
            raise ShellError(f"{command}: {done.returncode}: {said}")
        return said

    def cut(self) -> None:
        """End every process in it at once."""
        if self._process is None:
            return
        # The first process of a name space takes all others with it, and systemd-nspawn ends then by itself.
        os.kill(self._first() or self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._process = None

    def _first(self) -> int:
        """Return the process that is its systemd, 0 while there is none."""
        if self._process is None or self._process.poll() is not None:
            raise ShellError("the container has ended: see container.log")
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        return next((int(pid) for pid in children if _name(pid) == "systemd"), 0)

    def _is_up(self) -> bool:
        try:
            state = self.sh("systemctl is-system-running || true") if self._first() else ""
        except ShellError:
            if self._process is None or self._process.poll() is not None:
                raise
            return False
        return state in ("running", "degraded")


def _name(pid: str) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except FileNotFoundError:
        return ""
