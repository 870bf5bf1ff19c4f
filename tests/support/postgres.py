"""A real PostgreSQL on a free loopback port, for tests and benches, in a temporary folder of its own."""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Self

import psycopg
import pytest

from edge.core.processes import die_with_parent
from tests.support.broker import PATIENCE_S, free_port, wait_for

BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
needs_postgres = pytest.mark.skipif(not BINARIES, reason="postgresql is not installed")


class Postgres:
    """`with Postgres() as postgres:`; it keeps its data over a kill and a new start."""

    def __init__(self) -> None:
        self.port = free_port()
        self.url = f"postgresql+psycopg://postgres@127.0.0.1:{self.port}/postgres"
        self._words = f"host=127.0.0.1 port={self.port} user=postgres connect_timeout=2"
        self._made = 0
        self._folder = Path(tempfile.mkdtemp(prefix="greenhouse-postgres-"))
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        if self._user:
            account = pwd.getpwnam("postgres")
            os.chown(self._folder, account.pw_uid, account.pw_gid)
        words = ["-D", str(self._data), "-U", "postgres", "--auth=trust", "--no-sync", "--encoding=UTF8"]
        subprocess.run(
            [BINARIES[-1] / "initdb", *words], check=True, capture_output=True, cwd=self._folder, **self._user
        )
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.kill()
        shutil.rmtree(self._folder)

    def start(self) -> None:
        """Start, and wait until it answers."""
        words = ["-D", str(self._data), "-p", str(self.port), "-h", "127.0.0.1", "-k", str(self._folder)]
        with (self._folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [BINARIES[-1] / "postgres", *words],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                preexec_fn=die_with_parent,
                **self._user,
            )
        wait_for(self._answers, f"PostgreSQL answers, see {self._folder}/log")

    def new_database(self) -> str:
        """Make an empty database beside the others; return its URL."""
        self._made += 1
        with psycopg.connect(self._words, autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE made_{self._made}".encode())
        return f"{self.url.removesuffix('postgres')}made_{self._made}"

    def kill(self) -> None:
        """End it in the midst of what it does, its children too."""
        assert self.process is not None
        # Not SIGKILL: its children would live on and hold the shared memory. After SIGQUIT none writes.
        self.process.send_signal(signal.SIGQUIT)
        self.process.wait(PATIENCE_S)
        self.process = None

    @property
    def _data(self) -> Path:
        return self._folder / "data"

    @property
    def _user(self) -> dict[str, Any]:
        """Return the user to run as: PostgreSQL refuses to be root."""
        return {"user": "postgres"} if os.getuid() == 0 else {}

    def _answers(self) -> bool:
        try:
            psycopg.connect(self._words).close()
        except psycopg.OperationalError:
            return False
        return True
