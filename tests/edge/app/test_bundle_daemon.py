"""A new bundle comes to a daemon that runs: installed, in shadow, activated, and no tick is missed."""

import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.bundle.manifest import MANIFEST, SIGNATURE
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key
from edge.bundle.store import PACKAGED_FOLDER
from tests.support.broker import wait_for
from training.data.datasets import data_sha256, training_runs

pytestmark = pytest.mark.slow

SPEED = 600.0  # simulated seconds a second


def forecasters(folder: Path) -> set[str]:
    """Return the models that have forecast; the networks need a window of ticks first."""
    with closing(sqlite3.connect(folder / "history.db")) as history:
        return {name for (name,) in history.execute("select distinct predictor from v_forecasts")}


def told_of(folder: Path, key: str) -> bool:
    with closing(sqlite3.connect(folder / "history.db")) as history:
        return bool(history.execute("select 1 from events where key = ?", [key]).fetchall())


def archive(folder: Path, version: str, key: Path) -> Path:
    """The packaged models as another bundle."""
    files = folder / version
    files.mkdir()
    for path in PACKAGED_FOLDER.iterdir():
        if path.name not in (MANIFEST, SIGNATURE):
            (files / path.name).write_bytes(path.read_bytes())
    out = folder / f"{version}.zip"
    build_bundle(
        files,
        out,
        ManifestFacts(version, "2026-01-01T00:00:00Z", data_sha256(training_runs("interpolation"))),
        key,
    )
    return out


@pytest.fixture
def key(tmp_path: Path) -> Path:
    (tmp_path / "keys").mkdir()
    private = tmp_path / "keys" / "mine.pem"
    generate_key(private)
    return private


def test_a_bundle_comes_into_use_without_a_missed_tick(
    tmp_path: Path, key: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*words: object) -> str:
        assert main([*map(str, words)]) == 0
        return capsys.readouterr().out

    config = tmp_path / "edge.yaml"
    config.write_text(
        f"bundle: {{path: {tmp_path}/bundles, trusted_keys: {tmp_path}/keys}}\n"
        f"control_socket: {{path: {tmp_path}/control.sock}}\n"
    )
    bundle = archive(tmp_path, "2.0", key)
    command = [sys.executable, "-m", "edge", "demo", "--speed", str(SPEED), "--out", str(tmp_path)]
    daemon = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        wait_for((tmp_path / "control.sock").exists)
        assert "active: packaged; beside it: 2.0" in said("bundle", "--config", config, "install", bundle)
        assert "active: 2.0, on probation" in said("bundle", "--config", config, "activate")
        assert "active: packaged" in said("bundle", "--config", config, "rollback")
        wait_for(lambda: forecasters(tmp_path) == {"arx", "pbm", "lstm", "ham"}, patience_s=60.0)
        wait_for(lambda: told_of(tmp_path, "bundle.rollback"), patience_s=60.0)
        daemon.send_signal(signal.SIGINT)
        assert daemon.wait(timeout=90.0) == 0
    finally:
        daemon.kill()
        daemon.wait()
    with closing(sqlite3.connect(tmp_path / "history.db")) as history:
        ticks = history.execute("select seq, ticks_skipped from ticks order by seq").fetchall()
        events = [key for (key,) in history.execute("select key from events order by utc")]
    assert [seq for seq, _ in ticks] == list(range(ticks[0][0], ticks[0][0] + len(ticks)))
    assert not any(skipped for _, skipped in ticks)
    assert [key for key in events if key.startswith("bundle.")] == [
        "bundle.refresh", "bundle.activate", "bundle.rollback",
    ]  # fmt: skip
