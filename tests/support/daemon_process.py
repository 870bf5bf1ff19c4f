"""The whole daemon as a process for tests, with a control step of 1 s; surely dead afterwards."""

import sqlite3
import subprocess
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml

from edge.core.errors import RequestError
from edge.core.processes import die_with_parent
from edge.models.arx import Arx
from edge.models.arx_file import write_arx
from edge.sockets.client import request
from tests.support.broker import PATIENCE_S, wait_for

ROOT = Path(__file__).parents[2]
RIG = "greenhouse/rig-1"  # first part of every topic


class ChildProcess:
    """A command as a process whose output goes into `log_file`; surely dead after its `with`."""

    log_file: Path
    process: "subprocess.Popen[bytes] | None" = None

    @property
    def command(self) -> list[str]:
        """Return the command line."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> None:
        """Start; what follows waits for more than that."""
        self.launch()

    def launch(self) -> None:
        """Start, and wait for nothing."""
        with self.log_file.open("ab") as log:
            self.process = subprocess.Popen(
                self.command, stdout=log, stderr=log, cwd=ROOT, preexec_fn=die_with_parent
            )

    def kill(self) -> None:
        """kill -9, if it still runs."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(PATIENCE_S)

    def stop(self) -> int:
        """SIGTERM; the exit code."""
        assert self.process is not None
        self.process.terminate()
        return self.process.wait(PATIENCE_S)

    def has_ended(self) -> bool:
        """Return whether the process is over, or was never started."""
        return self.process is None or self.process.poll() is not None

    @property
    def log(self) -> str:
        """The output so far."""
        return self.log_file.read_text(errors="replace")


class DaemonProcess(ChildProcess):
    """`with DaemonProcess(folder, mqtt_port) as daemon:`; its board is the one whose files are in `folder`.

    mqtt_port : of a broker, or None for a daemon without telemetry
    sections : what differs from `configuration`, by section
    """

    def __init__(self, folder: Path, mqtt_port: int | None = None, **sections: Mapping[str, Any]) -> None:
        self.config = folder / "edge.yaml"
        self.socket = folder / "daemon.sock"
        self.history = folder / "history.db"
        self.state_file = folder / "state.json"
        self.log_file = folder / "daemon.log"
        settings = configuration(folder, mqtt_port)
        for name, values in sections.items():
            settings[name] = {**settings.get(name, {}), **values}
        self.config.write_text(yaml.safe_dump(settings))

    @property
    def command(self) -> list[str]:
        """Return the command line."""
        return run_command(self.config)

    def start(self) -> None:
        """Start, and wait for the first tick."""
        self.launch()
        wait_for(lambda: self.seq() or self.has_ended(), f"the first tick, see {self.log}")
        assert not self.has_ended(), self.log

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """One request over the control socket."""
        return request(self.socket, {"do": do, **values})

    def seq(self) -> int:
        """Return the number of the last tick, 0 while there is none."""
        try:
            tick = self.ask("status").get("tick")
        except RequestError:
            return 0
        return 0 if tick is None else int(tick["seq"])

    def wait_ticks(self, count: int) -> int:
        """Wait for so many more ticks; the number of the last one."""
        last = self.seq() + count
        wait_for(lambda: self.seq() >= last, f"tick {last}, see {self.log}")
        return last

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        """Query the history; a missing one is not created."""
        where = f"file:{self.history}?mode=rw"
        with closing(sqlite3.connect(where, timeout=10.0, uri=True)) as connection:
            return connection.execute(query).fetchall()

    def seqs(self) -> list[int]:
        """Numbers of the ticks in the history."""
        return [seq for (seq,) in self.rows("SELECT seq FROM ticks ORDER BY seq")]

    def has_event(self, key: str) -> bool:
        """Return whether the history holds an event of this key; a broken or missing one holds none."""
        try:
            return bool(self.rows(f"SELECT 1 FROM events WHERE key = '{key}'"))
        except sqlite3.Error:
            return False


def run_command(config: Path) -> list[str]:
    """Return the command line of a daemon."""
    return [sys.executable, "-m", "edge", "run", "--config", str(config)]


def configuration(folder: Path, mqtt_port: int | None) -> dict[str, Any]:
    """Return a rig that heats at once, all of its files in `folder`."""
    model = folder / "arx_1s.json"
    write_arx(one_second_model(), model, {"source": "made up for tests"})
    mqtt = {"enabled": False} if mqtt_port is None else {"enabled": True, "port": mqtt_port}
    return {
        "state_file": str(folder / "state.json"),
        "board": {"port": str(folder / "port")},
        "control_socket": {"path": str(folder / "daemon.sock")},
        "history": {"path": str(folder / "history.db"), "queue_ticks": 100},
        "page": {"folder": str(folder / "page")},
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
        "drift": {"reports": str(folder / "diagnosis")},
        "mqtt": {"host": "127.0.0.1", "rig": "rig-1", **mqtt},
        "control": {"step_s": 1, "model": str(model)},
        "reference": {"kind": "constant", "reference_c": 32.0},
        "safety": {"heater_rise_per_s": 1.0},  # full heat from the first tick on
        "box": {"heater_w": 100.0},
    }


def one_second_model() -> Arx:
    """Return a box that cools with a time constant of 1000 s and ends 30 K above the room at full heat."""
    return Arx(
        temp=np.array([0.999]),
        heater=np.array([0.03]),
        fan=np.array([-0.01]),
        ambient=0.001,
        intercept=0.0,
        step_s=1.0,
    )
