"""`greenhouse fleet ingest` as a process for tests and benches; surely dead afterwards."""

import sys
from pathlib import Path
from typing import Any

import yaml

from tests.support.daemon_process import ChildProcess


class IngestProcess(ChildProcess):
    """`with IngestProcess(folder, mqtt_port, numbers_url, database_url) as ingest:`"""

    def __init__(
        self, folder: Path, mqtt: dict[str, Any], numbers_url: str, database_url: str, **ingest: Any
    ) -> None:
        self.log_file = folder / "ingest.log"
        self.settings = folder / "fleet.yaml"
        self.journal = folder / "journal.jsonl"
        text = {
            "mqtt": {"host": "127.0.0.1", "rig": "fleet", **mqtt},
            "numbers": {"url": numbers_url},
            "database": {"url": database_url},
            "ingest": {"batch_s": 1.0, "gap_wait_s": 2.0, **ingest},
        }
        self.settings.write_text(yaml.safe_dump(text))

    @property
    def command(self) -> list[str]:
        """Return the command line."""
        words = ["fleet", "ingest", "--settings", str(self.settings), "--journal", str(self.journal)]
        return [sys.executable, "-m", "edge", *words]
