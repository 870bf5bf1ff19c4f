"""`greenhouse fleet ingest` as a process for tests and benches; surely dead afterwards."""

import subprocess
import sys
from pathlib import Path
from typing import Any, Self

import yaml

from edge.core.processes import die_with_parent
from tests.support.broker import PATIENCE_S
from tests.support.daemon_process import ROOT


class IngestProcess:
    """`with IngestProcess(folder, mqtt_port, numbers_url, database_url) as ingest:`"""

    def __init__(
        self, folder: Path, mqtt: dict[str, Any], numbers_url: str, database_url: str, **ingest: Any
    ) -> None:
        self._folder = folder
        self.settings = folder / "fleet.yaml"
        self.journal = folder / "journal.jsonl"
        text = {
            "mqtt": {"host": "127.0.0.1", "rig": "fleet", **mqtt},
            "numbers": {"url": numbers_url},
            "database": {"url": database_url},
            "ingest": {"batch_s": 1.0, "gap_wait_s": 2.0, **ingest},
        }
        self.settings.write_text(yaml.safe_dump(text))
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> None:
        """Start, and wait for nothing."""
        words = ["fleet", "ingest", "--settings", str(self.settings), "--journal", str(self.journal)]
        with (self._folder / "ingest.log").open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "edge", *words],
                stdout=log,
                stderr=log,
                cwd=ROOT,
                preexec_fn=die_with_parent,
            )

    def kill(self) -> None:
        """kill -9, if it still runs."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(PATIENCE_S)
            self.process = None

    def stop(self) -> int:
        """SIGTERM; the exit code."""
        assert self.process is not None
        self.process.terminate()
        code = self.process.wait(PATIENCE_S)
        self.process = None
        return code

    @property
    def log(self) -> str:
        """Its output so far."""
        return (self._folder / "ingest.log").read_text(errors="replace")
