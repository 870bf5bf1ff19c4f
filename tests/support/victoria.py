"""A real VictoriaMetrics on a free loopback port, for tests and benches."""

import shutil
import subprocess
import urllib.error
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import pytest

from edge.core.processes import die_with_parent
from tests.support.broker import PATIENCE_S, free_port, wait_for

VICTORIA = shutil.which("victoria-metrics")
needs_victoria = pytest.mark.skipif(VICTORIA is None, reason="victoria-metrics is not installed")
OPTIONS = (
    *("-dedup.minScrapeInterval=1ms", "-retentionPeriod=10y", "-snapshotsMaxAge=1d"),
    "-search.latencyOffset=1s",  # by default a query does not see the newest 30 s
)


class Victoria:
    """`with Victoria(tmp_path) as victoria:`; it keeps its data over a kill and a new start.

    port : usual: any that is free
    """

    def __init__(self, folder: Path, options: Sequence[str] = OPTIONS, port: int = 0) -> None:
        self._options = options
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._folder = folder
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.kill()

    def start(self) -> None:
        """Start, and wait until it answers."""
        assert VICTORIA is not None
        data, listen = f"-storageDataPath={self._folder}/numbers", f"-httpListenAddr=127.0.0.1:{self.port}"
        with (self._folder / "victoria.log").open("ab") as log:
            self.process = subprocess.Popen(
                [VICTORIA, data, listen, *self._options], stdout=log, stderr=log, preexec_fn=die_with_parent
            )
        wait_for(self._answers, f"VictoriaMetrics answers, see {self._folder}/victoria.log")

    def kill(self) -> None:
        """kill -9: what it held in memory alone is lost."""
        assert self.process is not None
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self.process = None

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.url}/health", timeout=1.0) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, OSError):
            return False
